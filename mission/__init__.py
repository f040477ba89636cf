"""Where to fly: circles next to the target, the transitions between them, and when to move.

Pure: time comes in as an argument, nothing here reads a clock, a socket or a file. Frames, units and the
clock are those of :mod:`estimators`.

Signs
-----
curvature_per_m    change of course per metre flown; positive turns right (clockwise seen from above).
clockwise        direction of flight round a circle, seen from above; its curvature is +1/radius.
left, right      of the target's direction of motion.
"""

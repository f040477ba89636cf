"""Target estimation: from laser and gimbal readings to a position and velocity with covariance.

Pure: time comes in as an argument, nothing here reads a clock, a socket or a file.

    readings -> sources -> pairing -> sighting -> track (gate, history, quality) -> estimate
                              ^                     |
                            pose              imm or ekf

:class:`sidelong.estimators.tracking.tracker.Tracker` contains all of it. Programs that already have detections use
:class:`sidelong.estimators.tracking.track.Track` directly.

Frames
------
plane    local plane: x east, y north, metres, origin at home.  Names end in ``_east_m``, ``_north_m``.
ned      north, east, down at the aircraft.
body     forward, right, down of the aircraft (FRD).
sight    forward along the line of sight, right, down: the gimbal's frame.

A rotation is named ``to_from``: ``v_ned = ned_from_body @ v_body``.
Quaternions are (w, x, y, z) and named the same way.

Angles are radians inside the code, degrees only at the edges (``_deg``). Bearings and courses are compass
angles: clockwise from north, so a bearing b points along (sin b, cos b) in the plane.

Time is the vehicle's own clock in seconds since its boot (``time_s``), because sensors stamp with it, a
recording keeps it, and a simulation that runs faster than the wall clock stays consistent.
"""

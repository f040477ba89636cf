"""A simulated vehicle, target and payload that speak MAVLink over UDP; shares no code with what it tests.

The core is :class:`sidelong.sitl.simulation.Simulation`: it is stepped by hand, takes and gives datagrams, and reads
no clock. :mod:`sidelong.sitl.server` puts sockets and a clock around it, :mod:`sidelong.sitl.cli` the command line.

Frames and units
----------------
plane    local plane: x east, y north, metres, origin at home. Heights are metres above home, altitudes above the
         ellipsoid (which the simulation takes for sea level).
body     forward, right, down.

Bearings, headings and courses are clockwise from north. Radians and metres inside; degrees, centimetres and the
other units of MAVLink only where a message is written or read. A positive roll, a positive lateral acceleration
and a positive turn all go to the right.

Time is the vehicle's own, in seconds since its boot (``now_s``, ``time_s``). Timers that watch a *link* run on the
stations' clock, because a ground station does not live faster when the simulation does: ``link_rate`` is how many
seconds of the vehicle pass in one of theirs.
"""

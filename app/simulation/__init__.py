"""The product in a closed loop without sockets: decoding, input checks, control step, exchange and a vehicle.

All run in one process on a fake clock. The vehicle is kinematic (fast); tests also fly that of
:mod:`sidelong.sitl`, frame by frame.
"""

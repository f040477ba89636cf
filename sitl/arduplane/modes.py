"""ArduPlane's flight modes, by their custom mode numbers."""

from enum import IntEnum


class Mode(IntEnum):
    MANUAL = 0
    FBWA = 5
    CRUISE = 7
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    GUIDED = 15


SELF_FLYING = (Mode.AUTO, Mode.RTL, Mode.LOITER, Mode.TAKEOFF, Mode.GUIDED)

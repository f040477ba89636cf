"""PX4's flight modes: main mode in the third byte of the custom mode, sub mode in the fourth."""

from enum import IntEnum


def custom_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


class Mode(IntEnum):
    MANUAL = custom_mode(1)
    ALTCTL = custom_mode(2)
    POSCTL = custom_mode(3)
    TAKEOFF = custom_mode(4, 2)
    HOLD = custom_mode(4, 3)
    MISSION = custom_mode(4, 4)
    RTL = custom_mode(4, 5)
    LAND = custom_mode(4, 6)
    STABILIZED = custom_mode(7)


BY_PILOT = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED)

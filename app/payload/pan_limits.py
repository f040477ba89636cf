"""What the pan limits of a gimbal mean for a watch."""

from __future__ import annotations

import math

from sidelong.mission.core.requirement import PAN_LIMIT_MIN_DEG

_CLOSED_RAD = math.radians(1.0)
_EQUAL_DEG = 2.0


def usable_pan_limit_deg(limits_rad: tuple[float, float] | None) -> float | None:
    """Return the pan limit that figures of eight can be planned for.

    Args:
        limits_rad: Least and greatest yaw off the nose; None: there are none.

    Returns:
        Degrees to each side of the nose; None for a gimbal that looks all around, or too little aside.
    """
    if limits_rad is None or _looks_all_around(limits_rad):
        return None
    nearer_deg = float(math.floor(math.degrees(min(-limits_rad[0], limits_rad[1])) + 0.1))
    return None if nearer_deg < PAN_LIMIT_MIN_DEG else nearer_deg


def pan_words(limits_rad: tuple[float, float] | None) -> list[str]:
    """Return what pan limits mean for a watch, one sentence; none if the gimbal looks all around.

    The aircraft turns through 360 degrees in each lap. A target outside the circle is therefore in every direction
    from the nose for the same time, wherever the circle is; only figures of eight avoid that.
    """
    if limits_rad is None or _looks_all_around(limits_rad):
        return []
    least_deg, most_deg = (math.degrees(limit_rad) for limit_rad in limits_rad)
    share = 100.0 - (most_deg - least_deg) / 3.6
    reach = f"the gimbal pans from {least_deg:.0f} to {most_deg:.0f} degrees off the nose"
    lost = f"on a circle it cannot look at the target for {share:.0f} % of each lap"
    instead = "" if usable_pan_limit_deg(limits_rad) is None else "; one aircraft flies figures of eight instead"
    return [f"{reach}: {lost}{instead}"]


def contradiction(configured_deg: float | None, limits_rad: tuple[float, float] | None) -> str:
    """Return that the configured pan limit is wider than the gimbal's, and what to do; empty: it is not."""
    limit_deg = usable_pan_limit_deg(limits_rad)
    if configured_deg is None or limit_deg is None or configured_deg <= limit_deg + _EQUAL_DEG:
        return ""
    return (
        f"aircraft.pan_limit_deg = {configured_deg:g}, but the gimbal pans {limit_deg:g} degrees only; "
        "remove it to plan for that"
    )


def _looks_all_around(limits_rad: tuple[float, float]) -> bool:
    return limits_rad[1] - limits_rad[0] >= math.tau - _CLOSED_RAD

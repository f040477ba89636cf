"""Requirements that the aircraft cannot meet with any planner, and which number to change.

Source: Liao et al., Defence Technology 16(4), 2020, equation 19; Beard and McLain, *Small Unmanned Aircraft*, 2012,
chapter 9 (coordinated turn).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement


@dataclass(frozen=True, slots=True)
class Change:
    """One number to change, alone, and the nearest value that works. ``field`` is its name in the value types."""

    field: str
    value: float
    nearest: float
    because: str

    def __str__(self) -> str:
        return f"{self.because}: {self.remedy}"

    @property
    def remedy(self) -> str:
        """What to change, and to what."""
        bound = "at least" if self.nearest > self.value else "at most"
        return f"{self.field} must be {bound} {self.nearest_rounded:g}, not {self.value:.4g}"

    @property
    def nearest_rounded(self) -> float:
        """``nearest`` to four digits, rounded to the side that works."""
        up, step = self.nearest > self.value, 10.0 ** (math.floor(math.log10(self.nearest)) - 3)
        rounded = float(f"{(math.ceil if up else math.floor)(self.nearest / step) * step:.4g}")
        if rounded < self.nearest if up else rounded > self.nearest:  # by what four digits leave out
            rounded = float(f"{rounded + (step if up else -step):.4g}")
        return rounded


def in_words(changes: Iterable[Change]) -> str:
    """Return the reasons in words, each once, with all the changes of which one is sufficient."""
    reasons = groupby(changes, key=lambda change: change.because)
    return "; ".join(f"{because}: {', or '.join(each.remedy for each in those)}" for because, those in reasons)


def unflyable(aircraft: Aircraft, requirement: Requirement) -> tuple[Change, ...]:
    """Return possible changes where no planner can keep the requirement, none where one can.

    The circle may be too tight, the target too fast, the band too narrow.
    """
    return tuple(_changes(aircraft, requirement))


def _changes(aircraft: Aircraft, requirement: Requirement) -> Iterator[Change]:
    radius_m, airspeed_m_s = aircraft.radius_m, aircraft.airspeed_m_s
    if radius_m < aircraft.min_radius_m:
        because = f"the circle is tighter than a bank of {math.degrees(aircraft.bank_max_rad):.0f} degrees allows"
        slow_m_s = math.sqrt(radius_m * GRAVITY_M_S2 * math.tan(aircraft.bank_max_rad))
        yield Change("radius_m", radius_m, aircraft.min_radius_m, because)
        yield Change("airspeed_m_s", airspeed_m_s, slow_m_s, because)
    fastest_m_s = requirement.target_speed_max_m_s
    if fastest_m_s >= airspeed_m_s:
        because = "the target is as fast as the aircraft"
        yield Change("target_speed_max_m_s", fastest_m_s, 0.99 * airspeed_m_s, because)
        yield Change("airspeed_m_s", airspeed_m_s, 1.01 * fastest_m_s, because)
    if not fits_band(aircraft, requirement):
        diameter_m, min_m, max_m = 2.0 * radius_m, requirement.range_min_m, requirement.range_max_m
        because = "the circle does not fit between the least and the greatest range"
        yield Change("range_max_m", max_m, min_m + diameter_m, because)
        if max_m > diameter_m:
            yield Change("range_min_m", min_m, max_m - diameter_m, because)
        if max_m > min_m:
            yield Change("radius_m", radius_m, (max_m - min_m) / 2.0, because)


def fits_band(aircraft: Aircraft, requirement: Requirement) -> bool:
    """Return whether a circle that touches range_min_m stays within range_max_m of a stationary target (19)."""
    return requirement.range_min_m + 2.0 * aircraft.radius_m <= requirement.range_max_m

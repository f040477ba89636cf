"""How the target is watched at this moment, by the same definitions as the judge of whole flights."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sidelong.app.analysis.score import GAP_MAX_S, STANDING_M_S, allowed_rad, middle_rad
from sidelong.app.analysis.target_course import TargetCourse
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import wrap_rad
from sidelong.mission.control.snapshot import Snapshot


@dataclass(frozen=True, slots=True)
class Watch:
    """The watch at one moment; None: unknown.

    Attributes:
        range_m: Estimated horizontal range.
        angle_rad: Observation angle, from the middle of where the target is to be watched from.
        in_band: Whether the range is the required one.
        on_side: Whether the side is the required one; unknown until the target has made good a course.
        side_known: Whether it has, or the side does not depend on its course.
        beyond_side_rad: How far the angle is beyond those that are on side; negative: within.
        course_rad: The target's course that defines the sides.
        present_course_rad: Its present course.
    """

    range_m: float | None = None
    angle_rad: float | None = None
    in_band: bool | None = None
    on_side: bool | None = None
    side_known: bool = False
    beyond_side_rad: float = math.nan
    course_rad: float | None = None
    present_course_rad: float | None = None


class PresentWatch:
    """Judges one snapshot after the other; remembers the target's course through its stops."""

    def __init__(self) -> None:
        self._course = TargetCourse(STANDING_M_S)

    def of(self, snapshot: Snapshot) -> Watch:
        """Return how the target is watched. Band and side are unknown while an input or the link fails."""
        estimate, aircraft, requirement = snapshot.estimate, snapshot.aircraft, snapshot.requirement
        if estimate is None or aircraft is None:
            return Watch()
        self._course.take_estimate(snapshot.time_s, estimate, requirement.course_horizon_s)
        made_good_rad, present_rad = self._course.made_good_rad, self._course.present_rad
        course_rad = present_rad if made_good_rad is None else made_good_rad
        target_m = estimate.position_m(snapshot.time_s)
        east_m, north_m = aircraft.east_m - target_m[0], aircraft.north_m - target_m[1]
        range_m = math.hypot(east_m, north_m)
        wanted = replace(requirement, side=snapshot.side)
        middle = middle_rad(wanted, math.nan if course_rad is None else course_rad)
        angle_rad = None if math.isnan(middle) else wrap_rad(math.atan2(east_m, north_m) - middle)
        beyond_rad = math.nan if angle_rad is None else abs(angle_rad) - allowed_rad(wanted)
        side_known = angle_rad is not None and (made_good_rad is not None or requirement.sector is not None)
        found = Watch(
            range_m,
            angle_rad,
            side_known=side_known or requirement.either_side,
            beyond_side_rad=beyond_rad,
            course_rad=course_rad,
            present_course_rad=present_rad,
        )
        elsewhere = snapshot.turn_payload or not snapshot.sensor_status.connected
        if estimate.quality is TrackQuality.LOST or snapshot.unknown or elsewhere:
            return found
        in_band = requirement.range_min_m <= range_m <= requirement.range_max_m
        on_side = beyond_rad <= 0.0 if side_known else None
        return replace(found, in_band=in_band, on_side=True if requirement.either_side else on_side)


class WatchShares:
    """The shares of the time so far in band and on side: from the first moment in the band, as a flight is judged.

    They start again when sidelong gets control of the aircraft; a log of another program's flight has none.

    Attributes:
        in_band: Share of the time in band; None before judging begins.
        on_side: Share of the time in which the side is known.
    """

    def __init__(self) -> None:
        self._begin(in_control=False)

    def _begin(self, *, in_control: bool) -> None:
        self.in_band: float | None = None
        self.on_side: float | None = None
        self._total_s = self._in_band_s = self._side_known_s = self._on_side_s = 0.0
        self._last: tuple[float, Watch] | None = None
        self._controlled = in_control

    def note(self, time_s: float, watch: Watch, *, in_control: bool) -> None:
        """Take the watch of now; it counts until the next one, as unknown for what is beyond ``GAP_MAX_S``."""
        if in_control and not self._controlled:
            self._begin(in_control=True)
        if self._last is None and not watch.in_band:
            return
        since_s, before = self._last or (time_s, watch)
        self._last = time_s, watch
        step_s = max(time_s - since_s, 0.0)
        sure_s = min(step_s, GAP_MAX_S)
        self._total_s += step_s
        self._in_band_s += sure_s * bool(before.in_band)
        if before.side_known:
            self._side_known_s += step_s
            self._on_side_s += sure_s * bool(before.on_side)
        self.in_band = self._in_band_s / self._total_s if self._total_s > 0.0 else None
        self.on_side = self._on_side_s / self._side_known_s if self._side_known_s > 0.0 else None

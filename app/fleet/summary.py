"""Summary of a fleet's flight: the requirement met by at least one aircraft, and their separation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any, Literal

import numpy as np
from rich.table import Table

from sidelong.app.analysis.score import Asked, BoolArray, Judgement, Moment, judge_moments
from sidelong.app.analysis.summary import Summary, percent
from sidelong.mission.core.path import FloatArray

_STEP_S, _APART_STEP_S = 0.5, 0.2
_HOLDS_S = 2.5  # how long a moment counts where none follows
_GAP_MAX_S = 2.0  # of a track: nothing is known of longer ones
_AIRBORNE_M = 10.0  # above home; below it, aircraft may be parked side by side


@dataclass(slots=True)
class FlownTrack:
    """Where one aircraft was. Times are mission time; heights above the home of all."""

    rows: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, time_s: float, east_m: float, north_m: float, height_m: float) -> None:
        """Take a place; those that are not later than the last are passed over."""
        if math.isfinite(height_m) and (not self.rows or time_s > self.rows[-1][0]):
            self.rows.append((time_s, east_m, north_m, height_m))

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return places of shape (n, 3), NaN on the ground and where there is none."""
        if len(self.rows) < 2:
            return np.full((len(times_s), 3), math.nan)
        rows = np.array(self.rows)
        places = np.column_stack([np.interp(times_s, rows[:, 0], rows[:, k]) for k in (1, 2, 3)])
        after = np.clip(np.searchsorted(rows[:, 0], times_s), 1, len(rows) - 1)
        known = (times_s >= rows[0, 0]) & (times_s <= rows[-1, 0])
        known &= rows[after, 0] - rows[after - 1, 0] <= _GAP_MAX_S
        places[~known | (places[:, 2] < _AIRBORNE_M)] = math.nan
        return places


@dataclass(frozen=True, slots=True)
class FlownAircraft:
    """One aircraft's part: its own summary, what it was judged by, and where it was.

    moments are on its own clock, offset_s added to that is mission time.
    """

    name: str
    summary: Summary
    moments: Sequence[Moment]
    offset_s: float
    track: FlownTrack


@dataclass(frozen=True, slots=True)
class AircraftSummary:
    """What one of them came to. ``summary`` is by the side it was to hold, which the coordinator changes.

    time_on_wanted_side: on the side that the requirement asks for, whichever it was to hold.
    """

    name: str
    summary: Summary
    time_on_wanted_side: float | None

    def as_json(self) -> dict[str, Any]:
        return {"name": self.name, "time_on_wanted_side": self.time_on_wanted_side, **self.summary.as_json()}


@dataclass(frozen=True, slots=True)
class TargetSummary:
    """Results for one target by at least one aircraft; longest_off_side_any_s: the longest time without any."""

    name: str
    time_on_side_any: float | None
    time_in_band_any: float | None
    longest_off_side_any_s: float | None


@dataclass(frozen=True, slots=True)
class FleetSummary:
    """The keys of a fleet's ``summary.json``. Fractions are 0..1 of the time since all were in the band.

    time_on_side_any, time_in_band_any: by at least one aircraft, the mean over the targets; longest_off_side_any_s:
    the longest time without, of any target. min_separation_m: in three dimensions, of any two in the air.
    """

    duration_s: float
    time_on_side_any: float | None
    time_in_band_any: float | None
    longest_off_side_any_s: float | None
    min_separation_m: float | None
    source: Literal["truth", "estimate"]
    outcome: str
    targets: tuple[TargetSummary, ...]
    aircraft: tuple[AircraftSummary, ...]

    def as_json(self) -> dict[str, Any]:
        plain = {name: getattr(self, name) for name in self.__slots__ if name not in ("targets", "aircraft")}
        targets = [asdict(one) for one in self.targets]
        return plain | {"targets": targets, "aircraft": [one.as_json() for one in self.aircraft]}

    def table(self) -> Table:
        """Return the summary as a table for the terminal, a column for each aircraft."""
        table = Table("", "all", *(one.name for one in self.aircraft), box=None, pad_edge=False)
        each = [one.summary for one in self.aircraft]
        if any(one.attention for one in each):
            table.add_row("attention", "", *(one.attention for one in each))
        table.add_row("outcome", self.outcome, *(one.outcome for one in each))
        table.add_row("watched", f"{self.duration_s:.0f} s", *(f"{one.duration_s:.0f} s" for one in each))
        table.add_row("time in band", percent(self.time_in_band_any), *(percent(one.time_in_band) for one in each))
        wanted = (percent(one.time_on_wanted_side) for one in self.aircraft)
        table.add_row("time on the required side", percent(self.time_on_side_any), *wanted)
        table.add_row("time on the side it was to hold", "", *(percent(one.time_on_side) for one in each))
        table.add_row("time unknown", "", *(percent(one.time_unknown) for one in each))
        for target in self.targets if len(self.targets) > 1 else ():
            table.add_row(f"  {target.name}", percent(target.time_on_side_any))
        table.add_row("longest time off the side", _seconds(self.longest_off_side_any_s))
        table.add_row("least separation", _metres(self.min_separation_m))
        table.add_row("least range", "", *(_metres(one.min_range_m) for one in each))
        table.add_row("moves of the circle", "", *(str(one.moves) for one in each))
        table.add_row("uploads, failed", "", *(f"{one.uploads}, {one.upload_failures}" for one in each))
        table.add_row("error of the estimate (RMS)", "", *(_metres(one.estimate_rmse_m, 2) for one in each))
        table.add_row("judged by", self.source)
        return table


def summarise_fleet(
    flown: Sequence[FlownAircraft],
    asked: Mapping[str, Asked],
    outcome: str,
    source: Literal["truth", "estimate"],
) -> FleetSummary:
    """Score the aircraft together: the required side is the requirement's, whichever side each aircraft held.

    asked: requirements of each target, in mission time.
    """
    by_target = [judged_by_target(one.moments, asked, one.offset_s) for one in flown]
    of_all = [Judgement.joined(list(own.values())) for own in by_target]
    judged = [own for own in of_all if own.time_s.size]
    times_s = np.empty(0)
    if judged:
        times_s = np.arange(_begin_s(judged), max(float(one.time_s[-1]) for one in judged), _STEP_S)
    targets = tuple(_target_summary(name, [one[name] for one in by_target], times_s) for name in asked)
    off_s = [one.longest_off_side_any_s for one in targets if one.longest_off_side_any_s is not None]
    return FleetSummary(
        duration_s=len(times_s) * _STEP_S,
        time_on_side_any=_mean([one.time_on_side_any for one in targets]),
        time_in_band_any=_mean([one.time_in_band_any for one in targets]),
        longest_off_side_any_s=max(off_s, default=None),
        min_separation_m=min_separation_m([one.track for one in flown]),
        source=source,
        outcome=outcome,
        targets=targets,
        aircraft=tuple(
            AircraftSummary(
                one.name,
                one.summary,
                float(_held(own, times_s, "on_side").mean()) if own.time_s.size and times_s.size else None,
            )
            for one, own in zip(flown, of_all, strict=True)
        ),
    )


def _target_summary(name: str, judged: Sequence[Judgement], times_s: FloatArray) -> TargetSummary:
    if not times_s.size:
        return TargetSummary(name, None, None, None)
    none = [np.zeros(len(times_s), bool)]
    side = np.logical_or.reduce(none + [_held(one, times_s, "on_side") for one in judged])
    band = np.logical_or.reduce(none + [_held(one, times_s, "in_band") for one in judged])
    return TargetSummary(name, float(side.mean()), float(band.mean()), _longest_run(~side) * _STEP_S)


def _mean(fractions: Sequence[float | None]) -> float | None:
    known = [one for one in fractions if one is not None]
    return sum(known) / len(known) if known else None


def min_separation_m(tracks: Sequence[FlownTrack]) -> float | None:
    """Return the least distance of two aircraft in the air, in three dimensions; None where no two ever were."""
    known = [track for track in tracks if len(track.rows) > 1]
    if len(known) < 2:
        return None
    begin_s, end_s = min(track.rows[0][0] for track in known), max(track.rows[-1][0] for track in known)
    times_s = np.arange(begin_s, end_s, _APART_STEP_S)
    places = [track.at(times_s) for track in known]
    apart_m = [np.linalg.norm(one - other, axis=1) for one, other in combinations(places, 2)]
    least_m = min((float(np.nanmin(one)) for one in apart_m if np.isfinite(one).any()), default=math.inf)
    return least_m if math.isfinite(least_m) else None


def judged_by_target(moments: Sequence[Moment], asked: Mapping[str, Asked], offset_s: float) -> dict[str, Judgement]:
    """Judge one aircraft's moments by what was asked of each target, in mission time: its own with offset_s added.

    A moment without a target's name is of the first one.
    """
    first = next(iter(asked))
    judged: dict[str, Judgement] = {}
    for name, own in asked.items():
        own_time = [(since_s - offset_s, requirement) for since_s, requirement in own]
        seen = [one for one in moments if (one.target or first) == name]
        judged[name] = judge_moments(seen, own_time).later(offset_s)
    return judged


def _begin_s(judged: Sequence[Judgement]) -> float:
    """Return when the last of them came into the band for the first time; those that never did are left out."""
    entered = [float(own.time_s[own.in_band][0]) for own in judged if own.in_band.any()]
    return max(entered) if entered else min(float(own.time_s[0]) for own in judged)


def _held(judged: Judgement, times_s: FloatArray, what: Literal["on_side", "in_band"]) -> BoolArray:
    """Return whether it held at these times, by the latest moment before; False where that is too old."""
    if not judged.time_s.size:
        return np.zeros(len(times_s), bool)
    latest = np.searchsorted(judged.time_s, times_s, side="right") - 1
    known = (latest >= 0) & (times_s - judged.time_s[np.maximum(latest, 0)] <= _HOLDS_S)
    return np.asarray(known & getattr(judged, what)[np.maximum(latest, 0)])


def _longest_run(flags: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def _seconds(duration_s: float | None) -> str:
    return "-" if duration_s is None else f"{duration_s:.0f} s"


def _metres(length_m: float | None, digits: int = 0) -> str:
    return "-" if length_m is None else f"{length_m:.{digits}f} m"

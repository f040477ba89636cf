"""What a flight or a replay came to, in numbers: of one aircraft, and of several together with their separation."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from rich.table import Table

from sidelong.app.analysis.score import (
    Asked,
    BoolArray,
    Breaches,
    Judgement,
    Moment,
    Score,
    from_band,
    judge_moments,
    score,
    within_pan_limits,
)
from sidelong.app.analysis.truth import Truth
from sidelong.estimators.filters.biases import Calibration, Delays
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.present import Present
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Requirement

_TRUTH_STEP_S = 0.5
_UNKNOWN_MAX = 0.05
_PROMPT_S = 0.05  # a smaller delay is not worth a setting
_EYE_M = 1.0  # of the target over its ground


@dataclass(frozen=True, slots=True)
class InputTime:
    input: Input
    state: InputState
    seconds: float
    times: int


class InputTimes:
    def __init__(self) -> None:
        self._latest: tuple[InputReport, ...] = ()
        self._changes: dict[Input, list[tuple[float, InputState]]] = defaultdict(list)

    def note(self, reports: tuple[InputReport, ...]) -> None:
        """Note changes of state since the last reports."""
        if reports is self._latest:  # displays ask at every event
            return
        self._latest = reports
        for report in reports:
            changes = self._changes[report.input]
            if not changes or changes[-1] != (report.since_s, report.state):
                changes.append((report.since_s, report.state))

    def between(self, start_s: float, end_s: float) -> tuple[InputTime, ...]:
        """Return how long each input was not ok, and in which state; the present ones last until ``end_s``."""
        seconds: dict[tuple[Input, InputState], list[float]] = defaultdict(list)
        for kind, changes in self._changes.items():
            for (since_s, state), (until_s, _) in itertools.pairwise([*changes, (end_s, InputState.OK)]):
                lasted_s = min(until_s, end_s) - max(since_s, start_s)
                if state is not InputState.OK and 0.0 < lasted_s < math.inf:
                    seconds[kind, state].append(lasted_s)
        return tuple(
            InputTime(kind, state, round(sum(lasted_s), 1), len(lasted_s))
            for (kind, state), lasted_s in seconds.items()
        )


@dataclass(frozen=True, slots=True)
class Summary:
    """The keys of ``summary.json``. Fractions are 0..1; None where there was nothing to measure by."""

    duration_s: float
    time_in_band: float | None
    time_on_side: float | None
    min_range_m: float | None
    max_range_m: float | None
    source: Literal["truth", "estimate"]
    moves: int
    uploads: int
    upload_failures: int
    sightings: int
    rejected: int
    estimate_rmse_m: float | None
    outcome: str
    time_in_sight: float | None = None
    min_clearance_m: float | None = None
    time_within_pan_limits: float | None = None  # None if the gimbal pans all around
    time_on_side_now: float | None = None  # by the target's present course, not by the one it made good
    reversals: int | None = None  # moves within 10 s of the last one; None in summaries of earlier versions
    time_unknown: float | None = None  # share in which inputs were missing or contradictory
    inputs: tuple[InputTime, ...] = ()  # how long each input was not ok
    gimbal_delay_s: float | None = None  # how late the payload stamped its readings, as estimated
    range_delay_s: float | None = None
    battery_percent: tuple[int, int] | None = None  # when watching began, and at the end
    links: tuple[dict[str, Any], ...] = ()  # each way to the vehicle, as ``LinkReport.as_json`` has it
    records_lost: str = ""  # why the records of the flight are incomplete; '' if they are complete

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def attention(self) -> str:
        """A warning for the first line; '' if most of the time is known."""
        if self.time_unknown is None or self.time_unknown <= _UNKNOWN_MAX:
            return ""
        return f"{percent(self.time_unknown)} of the time is unknown: inputs were missing or contradictory"

    def table(self) -> Table:
        table = Table(show_header=False, box=None, pad_edge=False)
        for row in self.rows():
            table.add_row(*row)
        return table

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield (name, value with unit) in the order of display; values that do not apply are left out."""
        if self.attention:
            yield "attention", self.attention
        yield "outcome", self.outcome
        yield "watched", f"{self.duration_s:.0f} s"
        yield "time in band", percent(self.time_in_band)
        yield "time on side", percent(self.time_on_side)
        yield "time unknown", percent(self.time_unknown)
        yield "by the target's present course", percent(self.time_on_side_now)
        known = self.min_range_m is not None and self.max_range_m is not None
        yield "range", f"{self.min_range_m:.0f} to {self.max_range_m:.0f} m" if known else "-"
        if self.time_in_sight is not None:
            yield "time in sight", percent(self.time_in_sight)
        if self.time_within_pan_limits is not None:
            yield "target within the pan limits", percent(self.time_within_pan_limits)
        if self.min_clearance_m is not None:
            yield "least height over the ground", f"{self.min_clearance_m:.0f} m"
        yield "judged by", self.source
        reversals = "" if self.reversals is None else f", {self.reversals} of them within 10 s of the last one"
        yield "moves of the circle", f"{self.moves}{reversals}"
        yield "uploads", f"{self.uploads}, failed {self.upload_failures}"
        yield "sightings", f"{self.sightings}, rejected {self.rejected}"
        yield "error of the estimate (RMS)", _shown(self.estimate_rmse_m, "m", 2)
        for fault in self.inputs:
            times = "" if fault.times == 1 else f", {fault.times} times"
            yield f"input {fault.input}", f"{fault.state} for {fault.seconds:.0f} s{times}"
        if self.gimbal_delay_s is not None and self.range_delay_s is not None:
            yield "delay of the payload", f"gimbal {self.gimbal_delay_s:.2f} s, laser {self.range_delay_s:.2f} s"
            if max(abs(self.gimbal_delay_s), abs(self.range_delay_s)) > _PROMPT_S:
                keys = f"gimbal_latency_s = {self.gimbal_delay_s:.2f}, range_latency_s = {self.range_delay_s:.2f}"
                yield "set for the next flight", f"sensors: {keys}"
        if self.battery_percent is not None:
            yield "battery", "from {} to {} %".format(*self.battery_percent)
        if self.records_lost:
            yield "records", f"incomplete: {self.records_lost}"
        for link in self.links:
            yield f"link {link['url']}", describe_link(link)


def describe_link(link: dict[str, Any]) -> str:
    """Return one link of a summary in words: signing, loss, round trip, rates, signal and refused frames."""
    loss, round_trip_s = link["loss"], link["round_trip_s"]
    words = [
        "signed" if link["signed"] else "unsigned",
        f"lost {percent(loss)}",
        f"round trip {'-' if round_trip_s is None else f'{1e3 * round_trip_s:.0f} ms'}",
        f"{link['received_bytes_s'] / 1e3:.1f} kB/s down, {link['sent_bytes_s'] / 1e3:.2f} kB/s up",
    ]
    if link["rssi"] is not None:
        words.append(f"signal {link['rssi']} here, {link['remote_rssi']} there")
    words += [f"refused {count} {why}" for why, count in link["refused"].items()]
    return ", ".join(words)


class SummaryCollector:
    """Notes aircraft, estimate and requirement as a mission goes along; ``summary`` judges them."""

    def __init__(self, requirement: Requirement) -> None:
        self._estimated: list[Moment] = []
        self._asked: list[tuple[float, Requirement]] = [(-math.inf, requirement)]
        self.judged_s = -math.inf  # time of the latest estimate that was taken
        self._blind_s = -math.inf  # time of the latest snapshot without an estimate
        self._departures_s: list[float] = []
        self._position_age_s = 0.0  # at the end
        self.input_times = InputTimes()  # how long each input was not ok
        self._over_ground: list[tuple[float, bool, float]] = []  # time, whether the target is seen, clearance
        self._within_pan: list[tuple[float, bool]] = []  # time, whether the gimbal can look at the target
        self._breaches = Breaches()
        self.ground: Ground | None = None  # what they are over, once it is known

    def observe(self, snapshot: Present) -> None:
        """Process a snapshot; only departures are taken from those without a new estimate."""
        self._position_age_s = snapshot.position_age_s
        self.input_times.note(snapshot.health)
        self._breaches.note(snapshot.time_s, bool(snapshot.breach))
        self._departures_s += [snapshot.time_s] * (snapshot.moves - len(self._departures_s))
        aircraft, estimate = snapshot.aircraft, snapshot.estimate
        if estimate is None:
            self._blind_s = snapshot.time_s
        if aircraft is None or estimate is None or estimate.time_s <= self.judged_s or snapshot.turn_payload:
            return  # a target that was never detected cannot be scored
        self.judged_s = estimate.time_s
        if self._asked[-1][1] != snapshot.requirement:
            self._asked.append((estimate.time_s, snapshot.requirement))
        place_m = aircraft.east_m, aircraft.north_m
        self._estimated.append(Moment.by_estimate(*place_m, estimate, snapshot.target, not snapshot.unknown))
        target_m = math.nan if self.ground is None else self.ground.height_m(estimate.east_m, estimate.north_m)
        if self.ground is not None and not math.isnan(target_m):
            seen = self.ground.sees(
                (*place_m, snapshot.height_m), (estimate.east_m, estimate.north_m, target_m + _EYE_M)
            )
            self._over_ground.append((estimate.time_s, seen, snapshot.height_m - self.ground.height_m(*place_m)))
        if snapshot.airframe.has_pan_limit and snapshot.attitude is not None:
            places = np.array([place_m]), np.array([[estimate.east_m, estimate.north_m]])
            heading_rad = np.array([snapshot.attitude.yaw_rad])
            (within,) = within_pan_limits(*places, heading_rad, snapshot.airframe.pan_limit_rad)
            self._within_pan.append((estimate.time_s, bool(within)))

    def over_ground(self, start_s: float) -> tuple[float | None, float | None]:
        """Return as ``Truth.over_ground``, by the estimated place: the share it is not hidden, and the clearance."""
        since = [(seen, clear_m) for time_s, seen, clear_m in self._over_ground if time_s >= start_s]
        clear = [clear_m for _, clear_m in since if not math.isnan(clear_m)]
        return sum(seen for seen, _ in since) / len(since) if since else None, min(clear, default=None)

    def time_within_pan_limits(self, start_s: float) -> float | None:
        """Return in which share (0 to 1) of the estimates since ``start_s`` the gimbal can look at the target."""
        since = [within for time_s, within in self._within_pan if time_s >= start_s]
        return sum(since) / len(since) if since else None

    def rmse_m(self, truth: Truth, plane: LocalPlane, start_s: float) -> float | None:
        """Return the root mean square of the estimate's distance from the truth since ``start_s``."""
        estimated = {moment.time_s: moment for moment in self._estimated if moment.time_s >= start_s}
        squares = [
            (estimated[true.time_s].target_east_m - true.target_east_m) ** 2
            + (estimated[true.time_s].target_north_m - true.target_north_m) ** 2
            for true in truth.at_each(list(estimated), plane)
            if true.target in ("", estimated[true.time_s].target)
        ]
        return math.sqrt(sum(squares) / len(squares)) if squares else None

    def moments(
        self, truth: Truth | None, plane: LocalPlane | None, start_s: float
    ) -> tuple[Sequence[Moment], Literal["truth", "estimate"]]:
        """Return what there is to judge since ``start_s``, and by what it is judged."""
        if truth is None or plane is None or not self._estimated:
            estimated = [moment for moment in self._estimated if moment.time_s >= start_s]
            return self._breaches.applied(estimated), "estimate"
        true = truth.moments(plane, start_s, max(self.judged_s, self._blind_s), _TRUTH_STEP_S)
        return self._breaches.applied(true), "truth"

    def scored(self, truth: Truth | None, plane: LocalPlane | None, start_s: float) -> Score:
        """Score from the first moment in the band after ``start_s``."""
        moments, source = self.moments(truth, plane, start_s)
        moments = from_band(moments, self._asked)
        judged = judge_moments(moments, self._asked)
        if source == "truth" or not moments:
            return score(judged, source, self._departures_s)
        known = np.array([moment.known for moment in moments])
        end_s = max(moments[-1].time_s, self._blind_s) + self._position_age_s
        return score(judged, source, self._departures_s, end_s, known)


def summarise(
    gatherer: SummaryCollector,
    snapshot: Present,
    *,
    truth: Truth | None,
    plane: LocalPlane | None,
    start_s: float,
    tracker: Tracker,
    outcome: str,
) -> Summary:
    """Return the summary of a flight, judged by the truth where it is known, otherwise by the estimate."""
    result = gatherer.scored(truth, plane, start_s)
    rmse_m = gatherer.rmse_m(truth, plane, start_s) if truth is not None and plane is not None else None
    delays = snapshot.delays
    in_sight, clearance_m = (truth or gatherer).over_ground(start_s)
    return Summary(
        **asdict(result),
        uploads=snapshot.uploads,
        upload_failures=snapshot.upload_failures,
        sightings=tracker.sightings,
        rejected=tracker.rejected,
        estimate_rmse_m=rmse_m,
        outcome=outcome,
        time_in_sight=in_sight,
        min_clearance_m=clearance_m,
        time_within_pan_limits=gatherer.time_within_pan_limits(start_s),
        inputs=gatherer.input_times.between(start_s, snapshot.time_s + snapshot.position_age_s),
        gimbal_delay_s=None if delays is None else round(delays.gimbal_s, 3),
        range_delay_s=None if delays is None else round(delays.range_s, 3),
    )


def percent(fraction: float | None) -> str:
    """Return a share from 0 to 1 as percent with one decimal; '-': not known."""
    return "-" if fraction is None else f"{100.0 * fraction:.1f} %"


def describe_calibration(calibration: Calibration, delays: Delays | None) -> str:
    """Return what was learnt of the payload's errors, each with one standard deviation."""
    yaw_deg, yaw_sigma_deg = math.degrees(calibration.yaw_bias_rad), math.degrees(calibration.yaw_sigma_rad)
    pitch_deg, pitch_sigma_deg = math.degrees(calibration.pitch_bias_rad), math.degrees(calibration.pitch_sigma_rad)
    return (
        f"gimbal errors found: yaw {yaw_deg:+.2f} +- {yaw_sigma_deg:.2f} degrees, "
        f"pitch {pitch_deg:+.2f} +- {pitch_sigma_deg:.2f} degrees"
    ) + ("" if delays is None else f"; delays: {delays}")


_STEP_S, _APART_STEP_S = 0.5, 0.2
_HOLDS_S = 2.5  # how long a moment counts where none follows
_GAP_MAX_S = 2.0  # of a track: nothing is known of longer ones
_AIRBORNE_M = 10.0  # above home; below it, aircraft may be parked side by side


@dataclass(slots=True)
class MissionTrack:
    """Where one aircraft was. Times are mission time; heights above the home of all."""

    rows: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, time_s: float, east_m: float, north_m: float, height_m: float) -> None:
        """Add a position; an older one than the last is ignored."""
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
    """One aircraft's part. moments are on its own clock; offset_s added to that is mission time."""

    name: str
    summary: Summary
    moments: Sequence[Moment]
    offset_s: float
    track: MissionTrack


@dataclass(frozen=True, slots=True)
class AircraftSummary:
    """What one came to by the side it was to hold, and on the required side, whichever it was to hold."""

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

    _any: by at least one aircraft, the mean over the targets; longest_off_side_any_s: of any target.
    min_separation_m: in three dimensions, of any two in the air.
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
        table = Table("", "all", *(one.name for one in self.aircraft), box=None, pad_edge=False)
        for row in self.rows():
            table.add_row(*row)
        return table

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield (name, value of the fleet, a value of each aircraft), '' where there is none."""
        each = [one.summary for one in self.aircraft]
        if any(one.attention for one in each):
            yield ("attention", "", *(one.attention for one in each))
        yield ("outcome", self.outcome, *(one.outcome for one in each))
        yield ("watched", f"{self.duration_s:.0f} s", *(f"{one.duration_s:.0f} s" for one in each))
        yield ("time in band", percent(self.time_in_band_any), *(percent(one.time_in_band) for one in each))
        wanted = (percent(one.time_on_wanted_side) for one in self.aircraft)
        yield ("time on the required side", percent(self.time_on_side_any), *wanted)
        yield ("time on the side it was to hold", "", *(percent(one.time_on_side) for one in each))
        yield ("time unknown", "", *(percent(one.time_unknown) for one in each))
        for target in self.targets if len(self.targets) > 1 else ():
            yield (f"  {target.name}", percent(target.time_on_side_any))
        yield ("longest time off the side", _shown(self.longest_off_side_any_s, "s"))
        yield ("least separation", _shown(self.min_separation_m, "m"))
        yield ("least range", "", *(_shown(one.min_range_m, "m") for one in each))
        yield ("moves of the circle", "", *(str(one.moves) for one in each))
        yield ("uploads, failed", "", *(f"{one.uploads}, {one.upload_failures}" for one in each))
        yield ("error of the estimate (RMS)", "", *(_shown(one.estimate_rmse_m, "m", 2) for one in each))
        yield ("judged by", self.source)


def summarise_fleet(
    flown: Sequence[FlownAircraft], asked: Mapping[str, Asked], outcome: str, source: Literal["truth", "estimate"]
) -> FleetSummary:
    """Score the aircraft together, by the required side, whichever each held; asked: of each target, mission time."""
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


def min_separation_m(tracks: Sequence[MissionTrack]) -> float | None:
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
    """Judge one aircraft's moments, without a name of the first target, by what was asked of each, mission time."""
    first = next(iter(asked))
    judged: dict[str, Judgement] = {}
    for name, own in asked.items():
        own_time = [(since_s - offset_s, requirement) for since_s, requirement in own]
        seen = [one for one in moments if (one.target or first) == name]
        own_judged = judge_moments(seen, own_time)
        judged[name] = replace(own_judged, time_s=own_judged.time_s + offset_s)
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


def _shown(value: float | None, unit: str, digits: int = 0) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"

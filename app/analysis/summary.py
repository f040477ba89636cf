"""What a flight or a replay came to, in numbers."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from rich.table import Table

from sidelong.app.analysis.score import Moment, Score, from_band, judge_moments, score, within_pan_limits
from sidelong.app.analysis.truth import Truth
from sidelong.estimators.filters.biases import Calibration, Delays
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.present import Present
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.requirement import Requirement

_TRUTH_STEP_S = 0.5
_UNKNOWN_MAX = 0.05
_PROMPT_S = 0.05  # a smaller delay is not worth a setting
_EYE_M = 1.0  # of the target over its ground


@dataclass(frozen=True, slots=True)
class InputTime:
    """How long an input was in a state, and how often it came into it."""

    input: Input
    state: InputState
    seconds: float
    times: int


class InputTimes:
    """Notes since when each input is in its state."""

    def __init__(self) -> None:
        self._latest: tuple[InputReport, ...] = ()
        self._changes: dict[Input, list[tuple[float, InputState]]] = defaultdict(list)

    def note(self, reports: tuple[InputReport, ...]) -> None:
        """Take the present states of all inputs, as a snapshot has them."""
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
    time_within_pan_limits: float | None = None
    """Share of the time in which the gimbal could look at the target; None if it pans all around."""
    time_on_side_now: float | None = None
    """By the target's present course; ``time_on_side`` is by the course it made good."""
    reversals: int | None = None
    """Moves within 10 s of the last one; None in summaries of earlier versions."""
    time_unknown: float | None = None
    """Share of the time in which missing or contradicting inputs made the judgement unknown."""
    inputs: tuple[InputTime, ...] = ()
    """How long each input was not ok."""
    gimbal_delay_s: float | None = None
    range_delay_s: float | None = None
    """How late the payload stamped its readings, as estimated; None while it was not known."""
    battery_percent: tuple[int, int] | None = None
    """When watching began, and at the end."""
    links: tuple[dict[str, Any], ...] = ()
    """Each way to the vehicle, as ``LinkReport.as_json`` has it."""
    records_lost: str = ""
    """Why the records of the flight are incomplete; '' if they are complete."""

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def attention(self) -> str:
        """A warning for the first line; '' if most of the time is known."""
        if self.time_unknown is None or self.time_unknown <= _UNKNOWN_MAX:
            return ""
        return f"{percent(self.time_unknown)} of the time is unknown: inputs were missing or contradictory"

    def table(self) -> Table:
        """Return the summary as a table for the terminal."""
        table = Table(show_header=False, box=None, pad_edge=False)
        for row in self.rows():
            table.add_row(*row)
        return table

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield names and values as a person reads them."""
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
        error_m = self.estimate_rmse_m
        yield "error of the estimate (RMS)", "-" if error_m is None else f"{error_m:.2f} m"
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
    """Return a link's measures in words."""
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
        self.ground: Ground | None = None  # what they are over, once it is known

    def observe(self, snapshot: Present) -> None:
        """Take a snapshot; only departures are taken from those without a new estimate."""
        self._position_age_s = snapshot.position_age_s
        self.input_times.note(snapshot.health)
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
        if self.ground is not None:
            self._look(self.ground, snapshot)
        if snapshot.pan_limit_rad < math.pi and math.isfinite(snapshot.heading_rad):
            places = np.array([[aircraft.east_m, aircraft.north_m]]), np.array([[estimate.east_m, estimate.north_m]])
            heading_rad = np.array([snapshot.heading_rad])
            (within,) = within_pan_limits(*places, heading_rad, snapshot.pan_limit_rad)
            self._within_pan.append((estimate.time_s, bool(within)))

    def _look(self, ground: Ground, snapshot: Present) -> None:
        aircraft, target, height_m = snapshot.aircraft, snapshot.estimate, snapshot.height_m
        assert aircraft is not None
        assert target is not None
        target_m = ground.height_m(target.east_m, target.north_m)
        if not math.isnan(target_m):
            here = aircraft.east_m, aircraft.north_m, height_m
            seen = ground.sees(here, (target.east_m, target.north_m, target_m + _EYE_M))
            self._over_ground.append(
                (target.time_s, seen, height_m - ground.height_m(aircraft.east_m, aircraft.north_m))
            )

    def over_ground(self, start_s: float) -> tuple[float | None, float | None]:
        """Return the share of time since ``start_s`` in which no hill hides the estimated place, and the clearance.

        As :meth:`sidelong.app.analysis.truth.Truth.over_ground` has them; None without elevation data.
        """
        since = [(seen, clear_m) for time_s, seen, clear_m in self._over_ground if time_s >= start_s]
        clear = [clear_m for _, clear_m in since if not math.isnan(clear_m)]
        return sum(seen for seen, _ in since) / len(since) if since else None, min(clear, default=None)

    def time_within_pan_limits(self, start_s: float) -> float | None:
        """Return the share of time since ``start_s`` in which the gimbal could look at the estimated place."""
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
            return [moment for moment in self._estimated if moment.time_s >= start_s], "estimate"
        return truth.moments(plane, start_s, max(self.judged_s, self._blind_s), _TRUTH_STEP_S), "truth"

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
    """Return the summary of a mission that ended at ``snapshot``."""
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
    """Return a share in words."""
    return "-" if fraction is None else f"{100.0 * fraction:.1f} %"


def describe_calibration(calibration: Calibration, delays: Delays | None) -> str:
    """Return what was learnt of the payload's errors, each with one standard deviation."""
    yaw_deg, yaw_sigma_deg = math.degrees(calibration.yaw_bias_rad), math.degrees(calibration.yaw_sigma_rad)
    pitch_deg, pitch_sigma_deg = math.degrees(calibration.pitch_bias_rad), math.degrees(calibration.pitch_sigma_rad)
    return (
        f"gimbal errors found: yaw {yaw_deg:+.2f} +- {yaw_sigma_deg:.2f} degrees, "
        f"pitch {pitch_deg:+.2f} +- {pitch_sigma_deg:.2f} degrees"
    ) + ("" if delays is None else f"; delays: {delays}")

"""Flights that know a route of the target: its own way, a wrong one, a road's, and departures at a random moment.

    python -m tests.bench.test_routes FOLDER [--mode MODE] [--airspeed 12|20|30] [--draws 3] [--horizon 20] [--pairs]
    python -m pytest -s tests/bench/test_routes.py

Modes: none; own (the track's path simplified to 5 m and displaced by 3 to 8 m, speeds and stops unknown); reversed,
shifted (by 60 m) and other (that of another track) are wrong; alongside (each NAME.route.csv). departures:
the target follows its route and leaves it at a random moment; the rest of its path is turned by 30 to 150 degrees.
--pairs: two aircraft, of which one counts; moves are those of both.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from sidelong.app.study.benchmark import CLASSES, AircraftClass
from sidelong.app.study.closed_loop import BOOT_S, fly, run
from sidelong.app.study.fleet import run_fleet
from sidelong.app.study.recorded import RecordedTarget, own_route, recorded_targets, route_next_to
from sidelong.app.study.settings import (
    PREDICTIVE,
    STUDIED,
    StudySettings,
    studied,
)
from sidelong.app.study.study import table_of
from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.route.route import Route
from tests.bench.size import size

OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
MODES = ("none", "own", "reversed", "shifted", "other", "alongside")
SHIFT_M, STEP_S, LEAST_M = 60.0, 0.5, 95.0
HORIZON_S = STUDIED.requirement.course_horizon_s
# A departure: followed for this long before it, flown on for this long; counted once the target is this far off the
# route and stays there until the report is due.
BEFORE_S, AFTER_S, OFF_M, DUE_S = 240.0, 180.0, 20.0, 15.0


def settings_of(
    one: AircraftClass,
    tracks: tuple[RecordedTarget, ...],
    draws: int = 1,
    horizon_s: float = HORIZON_S,
    fleet_size: int = 1,
) -> StudySettings:
    return StudySettings(
        (PREDICTIVE,),
        len(tracks),
        config=studied(**asdict(one), course_horizon_s=horizon_s, fleet_size=fleet_size),
        tracks=tracks,
        noise_draws=draws,
    )


def targets_in(folder: Path, one: AircraftClass, every: int = 1) -> tuple[RecordedTarget, ...]:
    return recorded_targets([folder], one.target_speed_max_m_s, route_next_to).flown[::every]


def _shifted(route: Route, by_m: float, towards_rad: float) -> Route:
    east_m, north_m = by_m * np.sin(towards_rad), by_m * np.cos(towards_rad)
    return replace(route, east_m=route.east_m + east_m, north_m=route.north_m + north_m)


def _reversed(route: Route) -> Route:
    return replace(route, east_m=route.east_m[::-1].copy(), north_m=route.north_m[::-1].copy())


def _routed(target: RecordedTarget, tracks: tuple[RecordedTarget, ...], mode: str, draw: int) -> RecordedTarget:
    """Return a target with the route of a mode."""
    rng = np.random.default_rng((5, target.key % 2**32, draw))
    route: Route | None
    match mode:
        case "none":
            route = None
        case "own":
            route = own_route(target, rng)
        case "reversed":
            route = _reversed(own_route(target, rng))
        case "shifted":
            route = _shifted(own_route(target, rng), SHIFT_M, rng.uniform(-np.pi, np.pi))
        case "other":
            others = [one for one in tracks if one is not target] or [target]
            route = own_route(others[int(rng.integers(len(others)))], rng)
        case _:
            route = target.route
    return replace(target, route=route)


def _flown(study: StudySettings, number: int, table: ValueTable) -> tuple[tuple[float, ...], np.ndarray]:
    """Return side, band, least range, moves and reversals of a run, and the times of its decisions."""
    if study.config.requirement.fleet_size == 1:
        x = run(study, PREDICTIVE, number, table)
        values = x.time_on_side, x.time_in_band, x.min_range_m, x.moves_per_hour, x.reversals_per_hour
        return values, x.decision_s
    pair = run_fleet(study, number, table)
    moves, reversals = (
        sum(rates) for rates in zip(*((x.moves_per_hour, x.reversals_per_hour) for x in pair.aircraft), strict=True)
    )
    return (pair.time_on_side_any, pair.time_in_band_any, pair.min_range_m, moves, reversals), pair.decision_s


def compared(
    folder: Path,
    one: AircraftClass,
    mode: str,
    draws: int,
    every: int = 1,
    horizon_s: float = HORIZON_S,
    fleet_size: int = 1,
) -> dict[str, float]:
    """Print one row of results over all tracks of a folder, and return it."""
    tracks = targets_in(folder, one, every)
    rows: dict[str, list[tuple[float, ...]]] = {}
    took_s: list[float] = []
    for draw in range(draws):
        flown = tuple(_routed(target, tracks, mode, draw) for target in tracks)
        study = settings_of(one, flown, draws, horizon_s, fleet_size)
        table = table_of(study)
        for k, target in enumerate(flown):
            values, decision_s = _flown(study, draw * len(flown) + k, table)
            rows.setdefault(target.name, []).append(values)
            took_s += list(decision_s)
    by_track = np.array([np.nanmean(several, axis=0) for several in rows.values()])
    runs = np.array([values for several in rows.values() for values in several])
    found = {
        "side": float(np.nanmean(by_track[:, 0])),
        "worst track": float(np.nanmin(by_track[:, 0])),
        "band": float(runs[:, 1].mean()),
        "worst band": float(runs[:, 1].min()),
        "least range, m": float(runs[:, 2].min()),
        "moves/h": float(by_track[:, 3].mean()),
        "reversals/h": float(by_track[:, 4].mean()),
        "decision p99, ms": 1e3 * float(np.percentile(took_s, 99)),
    }
    text = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
    print(f"{one} x {fleet_size}, route {mode}, {len(rows)} tracks x {draws}: {text}", flush=True)
    worst = sorted(rows, key=lambda name: float(np.nanmean([values[0] for values in rows[name]])))[:6]
    print("  " + ", ".join(f"{name} {np.nanmean([v[0] for v in rows[name]]):.3f}" for name in worst), flush=True)
    near = [f"{name} {v[2]:.0f} m" for name, several in rows.items() for v in several if v[2] < LEAST_M]
    if near:
        print(f"  below {LEAST_M:g} m: {', '.join(near)}", flush=True)
    return found


@dataclass(frozen=True, slots=True)
class Departure:
    """A target that leaves its route: leaves_s is when it is OFF_M away."""

    target: RecordedTarget
    leaves_s: float


@dataclass(frozen=True, slots=True)
class Left:
    """How a departure was noticed. delay_s: from OFF_M to the report; NaN: not reported; followed: before it."""

    name: str
    followed: bool
    delay_s: float
    min_range_m: float
    time_on_side: float


class _Noted(PredictivePlanner):
    """The predictive planner; notes (time, whether the target is on its route) at each decision."""

    def __init__(self, aircraft: Aircraft, requirement: Requirement, table: ValueTable, route: Route) -> None:
        super().__init__(aircraft, requirement, table)
        self.noted: list[tuple[float, bool]] = []
        self._memory = fresh_progress(route.east_m.size)
        self.follow(route, self._memory)

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        decision = super().decide(aircraft, target, present, wind, latency_s)
        self.noted.append((aircraft.time_s - BOOT_S, bool(self._memory.state[0].on_route)))
        return decision


def _departure(target: RecordedTarget, rng: np.random.Generator) -> Departure | None:
    """Return a track that leaves its route at a random moment; None if it stands about then, or stays near."""
    count = target.east_m.size
    at = int(rng.uniform(0.2, 0.8) * count)
    first, last = max(at - round(BEFORE_S / STEP_S), 0), min(at + round(AFTER_S / STEP_S), count)
    path = np.stack([target.east_m, target.north_m], axis=1)
    route = own_route(target, rng)
    turn_rad = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(30.0, 150.0))
    turned = np.array([[np.cos(turn_rad), np.sin(turn_rad)], [-np.sin(turn_rad), np.cos(turn_rad)]])
    path[at:] = path[at] + (path[at:] - path[at]) @ turned.T
    path = path[first:last]
    line = shapely.LineString(np.stack([route.east_m, route.north_m], axis=1))
    off_m = shapely.distance(line, shapely.points(path))
    beyond = off_m[at - first :] > OFF_M
    left = int(np.argmax(beyond)) if beyond.any() else -1
    due = round(DUE_S / STEP_S)
    if left < 0 or left > 60.0 / STEP_S or left + 3 * due > beyond.size or not beyond[left : left + 3 * due].all():
        return None
    start = path[0]
    moved = replace(route, east_m=route.east_m - start[0], north_m=route.north_m - start[1])
    flown = RecordedTarget(target.name, path[:, 0] - start[0], path[:, 1] - start[1], moved)
    return Departure(flown, STEP_S * (at - first + left))


def departures(folder: Path, runs: int, every: int = 1) -> Iterator[Left]:
    """Fly departures from the route, in turn with each class of aircraft and each track."""
    tracks = [targets_in(folder, one, every) for one in CLASSES]
    rng, number = np.random.default_rng(7), 0
    while number < runs:
        one = CLASSES[number % len(CLASSES)]
        among = tracks[number % len(CLASSES)]
        departure = _departure(among[int(rng.integers(len(among)))], rng)
        if departure is None:
            continue
        study = settings_of(one, (departure.target,))
        study = replace(study, seed=number)
        table = table_of(study)
        assert departure.target.route is not None
        planner = _Noted(study.aircraft(), study.requirement(), table, departure.target.route)
        unrouted = replace(study, tracks=(replace(departure.target, route=None),))
        score = fly(unrouted, 0, lambda *_of, planner=planner: planner)
        time_s, on = np.array(planner.noted).T
        near = (time_s > departure.leaves_s - 60.0) & (time_s <= departure.leaves_s)
        off = time_s[(time_s >= departure.leaves_s) & (on == 0.0)]
        delay_s = float(off[0] - departure.leaves_s) if off.size else float("nan")
        number += 1
        yield Left(departure.target.name, bool(on[near].any()), delay_s, score.min_range_m, score.time_on_side)


def left(folder: Path, runs: int, every: int = 1) -> list[Left]:
    """Print how departures were noticed, and return them."""
    flown = []
    for one in departures(folder, runs, every):
        flown.append(one)
        if not one.delay_s <= DUE_S or one.min_range_m < LEAST_M:
            print(
                f"  {one.name}: reported after {one.delay_s:.0f} s, least range {one.min_range_m:.0f} m", flush=True
            )
    delay_s = np.array([one.delay_s for one in flown])
    in_time = float(np.mean(delay_s <= DUE_S))
    print(
        f"{len(flown)} departures, {sum(one.followed for one in flown)} of a target known to be on its route before:"
        f" {100.0 * in_time:.0f} % reported within {DUE_S:g} s of {OFF_M:g} m, median {np.nanmedian(delay_s):.0f} s,"
        f" 95th percentile {np.nanpercentile(delay_s, 95):.0f} s, longest {np.nanmax(delay_s):.0f} s;"
        f" least range {min(one.min_range_m for one in flown):.0f} m,"
        f" {sum(one.min_range_m < LEAST_M for one in flown)} runs below {LEAST_M:g} m;"
        f" on side {100.0 * float(np.nanmean([one.time_on_side for one in flown])):.2f} %",
        flush=True,
    )
    return flown


def test_departures_are_reported_and_keep_the_range():
    flown = left(OWN, size(24, 1))
    assert all(one.delay_s <= DUE_S for one in flown)
    assert all(one.min_range_m >= LEAST_M for one in flown)


def test_the_own_route_helps_and_a_wrong_one_costs_nothing():
    every = size(1, 7)
    none, own, wrong = (compared(OWN, CLASSES[1], mode, 1, every) for mode in ("none", "own", "shifted"))
    assert own["side"] > none["side"]
    assert wrong["side"] > none["side"] - 0.01
    assert wrong["least range, m"] >= LEAST_M


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mode", choices=(*MODES, "departures"), default="departures")
    parser.add_argument("--airspeed", type=float, help="one class only: 12, 20 or 30 m/s")
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--horizon", type=float, default=HORIZON_S, help="requirement.course_horizon_s")
    parser.add_argument("--every", type=int, default=1, help="fly every n-th track")
    parser.add_argument("--pairs", action="store_true", help="two aircraft on each target")
    parser.add_argument("--runs", type=int, default=100, help="number of departures")
    given = parser.parse_args()
    if given.mode == "departures":
        left(given.folder, given.runs, given.every)
        return
    for one in CLASSES:
        if given.airspeed in (None, one.airspeed_m_s):
            compared(given.folder, one, given.mode, given.draws, given.every, given.horizon, 1 + given.pairs)


if __name__ == "__main__":
    sys.exit(main())

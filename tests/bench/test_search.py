"""How long recorded targets stay unseen behind hills, trees or with a broken gimbal, by what the aircraft does then.

    python -m pytest -s tests/bench/test_search.py
    python -m tests.bench.test_search FOLDER [--only search ...] [--targets 40] [--json FILE]

Each target is hidden once for 1 to 5 minutes, three minutes after the begin: by a hill 60 m from its path and
50 m high, or by trees 15 m from it and 15 m high, on the aircraft's side and as long as the way that the target goes
in that time; or the gimbal is silent. sidelong knows neither hill nor trees. The target is seen again when it is in
the camera's field of view (15 degrees to each side) for a second, in the laser's range and not hidden, and stays in
sight for 5 s. While it is unseen, the gimbal points at its predicted position; with "hold" and "retreat" it stays
where it pointed when the track was lost.

The clairvoyant bound is the time in which an aircraft that knows the future could fly straight to a place from which
the target is seen, 80 m from it or more: no turn is counted.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

from sidelong.app.planners.value_cache import value_table
from sidelong.app.simulation.target import RANGE_MAX_M, Payload
from sidelong.app.study.closed_loop import OnTicks, StudiedAircraft
from sidelong.app.study.recorded import RecordedTarget, recorded_targets
from sidelong.app.study.scene import first_circle, payload_of, scene
from sidelong.app.study.settings import PREDICTIVE, StudySettings, studied
from sidelong.estimators.estimate import TrackQuality
from sidelong.mission.control import controller as control
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.target_news import BLIND_S, UnseenTarget
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.geometry.approach import Reach, paths_to
from sidelong.mission.geometry.progress import dead_reckoned
from sidelong.mission.predictive.planner import USUAL, PredictivePlanner, table_configuration
from tests.bench.size import size

PREDICTED = UnseenTarget.predicted  # also where sidelong has to fly without it

OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
CLASSES = ((5.0, 12.0, 40.0), (9.0, 20.0, 70.0), (14.0, 30.0, 105.0))  # target's and aircraft's speed, its radius
HIDDEN_FROM_S, SEARCHED_S = 180.0, 420.0
CAUSES = "hill", "trees", "gimbal"
SCREENS_M = {"hill": (60.0, 50.0), "trees": (15.0, 15.0)}  # from the path, and high
HALF_VIEW_RAD, LOCK_S, STAYS_S, LOST_S = math.radians(15.0), 1.0, 5.0, 8.0
KEEP_M, EYE_M = 80.0, 1.0
BEHAVIOURS = "hold", "hold, gimbal at the prediction", "retreat", "square", "search"
LEG_M = 150.0  # of the expanding square


@dataclass(frozen=True)
class Case:
    """One target, hidden once; screen: its ends (2, 2) and height, None: the gimbal is silent."""

    target: RecordedTarget
    of: tuple[float, float, float]
    cause: str
    hidden_s: float

    @property
    def until_s(self) -> float:
        return min(self.target.duration_s - 1.0, HIDDEN_FROM_S + SEARCHED_S)

    def screen(self, aircraft_m: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the ends (2, 2) of the screen on the aircraft's side of the path, and its height."""
        off_m, high_m = SCREENS_M[self.cause]
        path_m = self.target.sampled(np.arange(HIDDEN_FROM_S, HIDDEN_FROM_S + self.hidden_s))[:, :2]
        way_m = path_m[-1] - path_m[0]
        if np.hypot(*way_m) < 10.0:
            course_rad = self.target.at(HIDDEN_FROM_S).course_rad
            way_m = np.array([math.sin(course_rad), math.cos(course_rad)])
        along = way_m / np.hypot(*way_m)
        across = np.array([along[1], -along[0]])
        across *= math.copysign(1.0, (aircraft_m - path_m[0]) @ across)
        shift_m = max((path_m - path_m[0]) @ across) + off_m
        first_m, last_m = min((path_m - path_m[0]) @ along) - off_m, max((path_m - path_m[0]) @ along) + off_m
        return path_m[0] + shift_m * across + np.outer((first_m, last_m), along), high_m


def cases(folder: Path, count: int) -> list[Case]:
    found: dict[str, tuple[RecordedTarget, tuple[float, float, float]]] = {}
    for one in CLASSES:
        for target in recorded_targets([folder], one[0]).flown:
            if target.duration_s > HIDDEN_FROM_S + 400.0:
                found.setdefault(target.name, (target, one))
    names = sorted(found)
    chosen = [names[k * len(names) // min(count, len(names))] for k in range(min(count, len(names)))]
    return [Case(*found[name], CAUSES[k % 3], 60.0 * (1 + k % 5)) for k, name in enumerate(chosen)]


def hides(screen: tuple[np.ndarray, float], eyes_m: np.ndarray, height_m: float, target_m: np.ndarray) -> np.ndarray:
    """Return whether a screen is in the lines of sight from places (n, 2) at a height to the target (2,)."""
    (first_m, last_m), high_m = screen
    ray_m, wall_m, to_m = eyes_m - target_m, last_m - first_m, first_m - target_m
    cross = ray_m[:, 0] * wall_m[1] - ray_m[:, 1] * wall_m[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        at_ray = (to_m[0] * wall_m[1] - to_m[1] * wall_m[0]) / cross
        at_wall = (to_m[0] * ray_m[:, 1] - to_m[1] * ray_m[:, 0]) / cross
    crossed = (at_ray > 0.0) & (at_ray < 1.0) & (at_wall > 0.0) & (at_wall < 1.0)
    return crossed & (EYE_M + at_ray * (height_m - EYE_M) < high_m)


class Camera(Payload):
    """A gimbal camera that follows the target while it sees it, and else points at ``points_m``."""

    def __init__(self, of: Payload, run: Run) -> None:
        self.__dict__.update(of.__dict__)
        self._run = run

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, *, heading_rad=0.0, with_range=True):  # type: ignore[no-untyped-def]
        visible, silent = self._run.look(time_s)
        if visible:
            return super().measure(
                time_s, boot_ms, east_m, north_m, up_m, heading_rad=heading_rad, with_range=with_range
            )
        if silent:
            return []
        away_m = np.array(self._run.points_m) - self._run.aircraft_m
        pitch_rad = math.atan2(up_m, max(math.hypot(*away_m), 1.0))
        return [self.gimbal(boot_ms, math.atan2(*away_m), pitch_rad)]


class Run:
    """One flight, until the target is seen again."""

    def __init__(self, case: Case, behaviour: str) -> None:
        speed_max_m_s, airspeed_m_s, radius_m = case.of
        config = studied(airspeed_m_s=airspeed_m_s, radius_m=radius_m, target_speed_max_m_s=speed_max_m_s)
        study = StudySettings((PREDICTIVE,), 1, config=config, tracks=(case.target,))
        table, flown = value_table(table_configuration(study.aircraft(), study.requirement())), scene(study, 0)
        self._case, self._target = case, OnTicks(case.target, flown.duration_s)
        self._follows = behaviour in BEHAVIOURS[1:2] + BEHAVIOURS[3:]
        self._screen: tuple[np.ndarray, float] | None = None
        self._locked, self._in_view_s, self._seen_since_s = True, math.nan, 0.0
        self.points_m, self.lost_s, self.seen_s = (0.0, 0.0), math.nan, math.nan
        self._craft = StudiedAircraft(
            study,
            flown,
            self._target,
            first_circle(study, flown),
            flown.sensor_rng,
            lambda own, wanted, plans: PredictivePlanner(
                own, wanted, table, USUAL, check=plans.cleared, sight=plans.sight
            ),
        )
        vehicle = self._craft.vehicle_in_flight
        vehicle._payload = Camera(Payload(payload_of(study)[0], flown.sensor_rng), self)
        self._density = UnseenTarget(self._craft.controller.tracker)

    @property
    def aircraft_m(self) -> np.ndarray:
        craft = self._craft.vehicle_in_flight.craft
        return np.array([craft.east_m, craft.north_m])

    def look(self, time_s: float) -> tuple[bool, bool]:
        """Return whether the camera sees the target, and whether the gimbal is silent."""
        truth, craft, case = self._target.at(time_s), self._craft.vehicle_in_flight.craft, self._case
        here_m, target_m = self.aircraft_m, np.array([truth.east_m, truth.north_m])
        since_s = time_s - HIDDEN_FROM_S
        if since_s >= 0.0 and self._screen is None and case.cause != "gimbal":
            self._screen = case.screen(here_m)
        silent = case.cause == "gimbal" and 0.0 <= since_s < case.hidden_s
        hidden = self._screen is not None and bool(hides(self._screen, here_m[None], craft.height_m, target_m)[0])
        open_to_it = not hidden and not silent and math.hypot(*(target_m - here_m), craft.height_m) < RANGE_MAX_M
        self._point()
        if not open_to_it:
            self._locked, self._in_view_s = False, math.nan
        elif not self._locked:
            bearings_rad = [math.atan2(*(np.array(place_m) - here_m)) for place_m in (target_m, self.points_m)]
            if abs(math.remainder(bearings_rad[0] - bearings_rad[1], math.tau)) > HALF_VIEW_RAD:
                self._in_view_s = math.nan
            elif math.isnan(self._in_view_s):
                self._in_view_s = time_s
            self._locked = time_s - self._in_view_s >= LOCK_S
            self._seen_since_s = time_s
        self._note(time_s)
        return self._locked, silent

    def _note(self, time_s: float) -> None:
        if self._locked:
            if not math.isnan(self.lost_s) and time_s - self._seen_since_s >= STAYS_S and math.isnan(self.seen_s):
                self.seen_s = self._seen_since_s - self.lost_s
            self._last_s = time_s
        elif time_s > HIDDEN_FROM_S and time_s - self._last_s >= LOST_S and math.isnan(self.lost_s):
            self.lost_s = self._last_s

    def _point(self) -> None:
        estimate = self._craft.controller.estimate
        if estimate is not None and (self._follows or estimate.quality is not TrackQuality.LOST):
            self.points_m = estimate.east_m, estimate.north_m

    def fly(self) -> dict[str, float | str]:
        """Return when the target was seen again after it was lost, and the least distances until then, m."""
        craft, case, controller = self._craft, self._case, self._craft.controller
        nearest_m = clear_m = math.inf
        inside, moments, start_m = 0, 0, None
        while craft.simulated.time_s < case.until_s and math.isnan(self.seen_s):
            craft.run(1.0)
            now_s = craft.simulated.time_s
            truth, here_m = self._target.at(round(now_s * 5.0) / 5.0), self.aircraft_m
            estimate = controller.tracker.estimate(controller.time_s)
            if estimate is not None:
                limit_m_s = case.of[0]
                if controller.time_s - estimate.last_sighting_s <= BLIND_S:
                    self._density.note(estimate, limit_m_s)
                else:
                    predicted = PREDICTED(self._density, estimate, limit_m_s, 60.0)
            if now_s > HIDDEN_FROM_S and start_m is None:
                start_m, height_m = here_m, craft.vehicle_in_flight.craft.height_m
            if not math.isnan(self.lost_s):
                target_m = np.array([truth.east_m, truth.north_m])
                nearest_m = min(nearest_m, math.dist(here_m, target_m))
                if controller.time_s - estimate.last_sighting_s > BLIND_S:
                    disk = UnseenTarget.density(predicted)
                    clear_m = min(clear_m, math.dist(here_m, (disk.east_m, disk.north_m)) - disk.radius_m)
                    moments += 1
                    inside += math.dist(target_m, (disk.east_m, disk.north_m)) < disk.radius_m
        return {
            "target": case.target.name,
            "cause": case.cause,
            "hidden_s": case.hidden_s,
            "lost_s": self.lost_s,
            "seen_s": self.seen_s,
            "watched_s": craft.simulated.time_s - self.lost_s,
            "least_range_m": nearest_m,
            "least_to_disk_m": clear_m,
            "moments": moments,
            "in_disk": inside,
            "bound_s": self.bound_s(start_m, height_m, case.of[1]),
        }

    def bound_s(self, start_m: np.ndarray, height_m: float, airspeed_m_s: float) -> float:
        """Return when the target could be seen at the earliest, from the loss on; NaN if it was not lost."""
        if math.isnan(self.lost_s):
            return math.nan
        around_rad, ranges_m = np.arange(72) * math.tau / 72, np.arange(KEEP_M, 641.0, 20.0)
        ring = np.stack([np.sin(around_rad), np.cos(around_rad)], axis=1)
        offsets_m = (ranges_m[:, None, None] * ring).reshape(-1, 2)
        for time_s in np.arange(self.lost_s + 1.0, self._case.until_s):
            truth = self._target.at(time_s)
            target_m = np.array([truth.east_m, truth.north_m])
            places_m = target_m + offsets_m
            free = np.hypot(*(places_m - start_m).T) <= airspeed_m_s * (time_s - self.lost_s)
            if self._screen is not None:
                free &= ~hides(self._screen, places_m, height_m, target_m)
            elif time_s < HIDDEN_FROM_S + self._case.hidden_s:
                continue
            if free.any():
                return float(time_s - self.lost_s)
        return math.inf


def hold(self: StandoffController, *_: object, **_given: object) -> tuple[()]:
    return self._hold("the target is not seen")


def retreat(self: StandoffController, aircraft: AircraftState, present: Plan, _density: Reach) -> object:
    """Keep away from wherever the target can have gone at its greatest speed."""
    assert self.estimate is not None
    speed_max_m_s = self.settings.requirement.target_speed_max_m_s
    reach = self._unseen.reach(self.time_s, self.estimate, True, speed_max_m_s)
    assert reach is not None
    return self._hold_away(aircraft, present, reach)


def expanding_square() -> Callable[..., object]:
    """Return a search in an expanding square about the last known position, as circles at its corners."""
    datum_m: list[tuple[float, float]] = []
    corners: list[tuple[float, float]] = []

    def search(self: StandoffController, aircraft: AircraftState, _present: Plan, _density: Reach) -> object:
        own, seen = self.settings.aircraft, self.tracker.last_seen
        assert seen is not None
        here_m = seen.east_m, seen.north_m
        if datum_m != [here_m]:
            datum_m[:], corners[:] = [here_m], [here_m]
        elif math.dist(corners[-1], (aircraft.east_m, aircraft.north_m)) > 1.5 * own.radius_m:
            return self._hold("on a leg of the square")
        else:
            leg = len(corners) - 1
            length_m, course_rad = LEG_M * (1 + leg // 2), 0.5 * math.pi * leg
            east_m, north_m = corners[-1]
            corners.append((east_m + length_m * math.sin(course_rad), north_m + length_m * math.cos(course_rad)))
        plans = paths_to(Circle(*corners[-1], own.radius_m, True), dead_reckoned(aircraft, 1.0), own)
        if not plans:
            return self._hold("too near to the corner")
        return self.changes.upload(self.time_s, plans[0], self._wind, "the next corner")

    return search


def flown(case: Case, behaviour: str) -> dict[str, float | str]:
    """Fly a target with a behaviour in place of the product's own."""
    patches: list[object] = []
    if behaviour in ("hold", "retreat"):  # as sidelong flew before it searched: it went on planning until the loss
        patches = [
            mock.patch.object(control, "BLIND_S", math.inf),
            mock.patch.object(UnseenTarget, "predicted", lambda _self, estimate, *_: estimate),
            mock.patch.object(StandoffController, "_search", hold if behaviour == "hold" else retreat),
        ]
    if behaviour == "hold":
        patches.append(mock.patch.object(StandoffController, "_hold_away", hold))
    if behaviour.startswith("hold,"):
        patches.append(mock.patch.object(StandoffController, "_search", hold))
    if behaviour == "square":
        patches.append(mock.patch.object(StandoffController, "_search", expanding_square()))
    run = Run(case, behaviour)
    with ExitStack() as stack:
        for one in patches:
            stack.enter_context(one)  # type: ignore[arg-type]
        return run.fly()


def summed_up(rows: list[dict[str, float | str]], behaviour: str) -> dict[str, float]:
    """Print a line of the table; return the medians."""
    lost = [row for row in rows if not math.isnan(row["lost_s"])]

    def median(chosen: list[dict[str, float | str]], key: str = "seen_s") -> float:
        times = [math.inf if math.isnan(row[key]) else row[key] for row in chosen]
        return statistics.median(times) if times else math.nan

    by_cause = {cause: median([row for row in lost if row["cause"] == cause]) for cause in CAUSES}
    unseen = sum(math.isnan(row["seen_s"]) for row in lost)
    share = sum(row["in_disk"] for row in lost) / max(sum(row["moments"] for row in lost), 1)
    bound_s = median(lost, "bound_s")
    print(
        f"{behaviour:32} {len(lost):3} lost  seen again after {median(lost):6.0f} s  "
        + "  ".join(f"{cause} {value:4.0f}" for cause, value in by_cause.items())
        + f"  not at all {unseen:2}  least range {min(row['least_range_m'] for row in lost):5.0f} m  "
        f"to the disk {min(row['least_to_disk_m'] for row in lost):6.0f} m  in the disk {100 * share:5.1f} %  "
        f"bound {bound_s:4.0f} s",
        flush=True,
    )
    return {"seen_s": median(lost), "bound_s": bound_s, "least_range_m": min(row["least_range_m"] for row in lost)}


def test_a_search_sees_targets_again_sooner_than_a_held_circle():
    chosen = cases(OWN, size(6, 3))
    found = {one: summed_up([flown(case, one) for case in chosen], one) for one in ("hold", "search")}
    assert found["search"]["seen_s"] <= found["hold"]["seen_s"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=BEHAVIOURS, choices=BEHAVIOURS)
    parser.add_argument("--targets", type=int, default=40)
    parser.add_argument("--json", type=Path, help="keep each flight here, and fly only those that are not there yet")
    given = parser.parse_args()
    kept: dict[str, list[dict[str, float | str]]] = {}
    if given.json is not None and given.json.exists():
        kept = json.loads(given.json.read_text())
    for behaviour in given.only:
        rows = kept.setdefault(behaviour, [])
        for case in cases(given.folder, given.targets)[len(rows) :]:
            rows.append(flown(case, behaviour))
            if given.json is not None:
                given.json.write_text(json.dumps(kept, indent=1))
        summed_up(rows, behaviour)


if __name__ == "__main__":
    main()

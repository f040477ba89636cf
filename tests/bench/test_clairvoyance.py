"""How well recorded targets are watched by a planner that knows what they will do: the price of not knowing.

    python -m tests.bench.test_clairvoyance FOLDER --airspeed 12 --radius 40 --target-speed-max 5 [--known S]
    python -m pytest -s tests/bench/test_clairvoyance.py

The planner is the predictive one, with the same moves, prices and noisy filter, but with one future, the true one. It
looks over 30 s, and its watch course is the one which is judged. So this bounds what a better forecast could
bring this planner, not what can be flown at all. With --known it is given this many seconds only; from there on the
target goes straight on or turns, as the planner itself expects.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

from sidelong.app.planners.value_cache import value_table
from sidelong.app.study.closed_loop import BOOT_S, fly
from sidelong.app.study.judging import RunResult
from sidelong.app.study.recorded import recorded_targets
from sidelong.app.study.scene import scene
from sidelong.app.study.settings import (
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState, Decision, Plan, PlanCheck
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.core.sight import Sight
from sidelong.mission.predictive import planner as planner_module
from sidelong.mission.predictive.decision_kernel import Question, commitment, look_two_moves_ahead
from sidelong.mission.predictive.moves_kernel import MOVES
from sidelong.mission.predictive.planner import PredictivePlanner, PredictiveSettings, table_configuration
from sidelong.mission.predictive.rollout_kernel import Scenarios
from sidelong.mission.predictive.scene_kernel import PREDICTED_S, Scene, Turns, classes_about
from sidelong.mission.viewpoint.watch_course import courses_made_good_rad

OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
STEP_S, PER_S, LOOKED_S, HORIZON_S = 0.1, 10, 30.0, 20.0


class Clairvoyant(PredictivePlanner):
    """truth (n, 5): of the target, each STEP_S; known_s: how far ahead it is given."""

    def __init__(self, planner: PredictivePlanner, truth: np.ndarray, known_s: float) -> None:
        settings = replace(PredictiveSettings(), horizon_s=LOOKED_S)
        super().__init__(planner.aircraft, planner.requirement, *planner.tables, settings)
        ending = round(2.0 * PREDICTED_S / STEP_S)
        self._place = np.pad(truth[:, :2], ((0, ending), (0, 0)), "edge")
        self._known = round(min(known_s, PREDICTED_S) / STEP_S)

    def _paths(self, first: int, k: int, turns: Turns) -> np.ndarray:
        """Return places (f, n, 2) each second, from the start of the run until k seconds after a step."""
        given = self._place[first % PER_S : first + self._known + 1 : PER_S]
        ahead_s = np.arange(first // PER_S + k + 1 - len(given))
        if ahead_s.size == 0 or len(given) < 2:
            return self._place[None, first % PER_S : first + k * PER_S + 1 : PER_S]
        velocity = given[-1] - given[-2]
        faded_s = turns.fades_s * (1.0 - np.exp(-(ahead_s + 0.5) / turns.fades_s))
        course_rad = math.atan2(*velocity) + turns.rate_rad_s[:, None] * faded_s
        steps = math.hypot(*velocity) * np.stack([np.sin(course_rad), np.cos(course_rad)], axis=2)
        uninformed = given[-1] + np.cumsum(steps, axis=1)
        return np.concatenate([np.repeat(given[None], len(uninformed), axis=0), uninformed], axis=1)

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        with mock.patch.object(planner_module, "weigh", self._weigh):
            return super().decide(aircraft, target, present, wind, latency_s)

    def _weigh(self, scene: Scene, question: Question, sight: Sight) -> tuple[float, float, np.ndarray]:
        """Weigh the moves by what the target does, in place of what it may do."""
        futures = self._futures(scene, question)
        min_gain_s, costs = commitment(scene, futures, question), np.empty(MOVES)
        return look_two_moves_ahead(scene, futures, question, sight, min_gain_s, costs), min_gain_s, costs

    def _futures(self, scene: Scene, question: Question) -> Scenarios:
        k = min(PREDICTED_S, math.ceil(8.0 * scene.radius_m / scene.air.airspeed_m_s) + 40)
        paths = self._paths(round((scene.departure_s - BOOT_S) / STEP_S), k, question.context.turns)
        time_s, per_s = STEP_S * PER_S * np.arange(paths.shape[1]), STEP_S * PER_S
        made_good = np.array(
            [
                courses_made_good_rad(time_s, path, np.gradient(path, per_s, axis=0), np.full(time_s.size, HORIZON_S))
                for path in paths
            ]
        )
        made_good = np.where(np.isnan(made_good), scene.course_rad, made_good)
        facing_rad = scene.mirror * (made_good[:, -k - 1 : -1] - scene.course_rad)
        off = paths[:, -k - 1 :] - (scene.frame_east_m, scene.frame_north_m)
        sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
        across = scene.mirror * (off[..., 0] * cos_c - off[..., 1] * sin_c)
        place = np.stack([across, off @ (sin_c, cos_c)], axis=2)
        velocity = np.diff(place, axis=1)
        speed_m_s = np.hypot(velocity[..., 0], velocity[..., 1])
        course_rad = np.where(speed_m_s > 0.5, np.arctan2(velocity[..., 0], velocity[..., 1]), facing_rad)
        shape = *speed_m_s.shape, 4
        classes, share, turn_share = np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape)
        for at, speed in np.ndenumerate(speed_m_s):
            classes[at], share[at], turn_share[at] = classes_about(question.context.motions, 0.0, speed, 0.0, 0.0)
        facing = np.stack([np.sin(facing_rad), np.cos(facing_rad), np.zeros_like(facing_rad)], axis=2)
        course = np.stack([np.sin(course_rad), np.cos(course_rad), course_rad], axis=2)
        known = np.concatenate([place[:, :-1], velocity], axis=2)
        return Scenarios(
            np.full(len(paths), 1.0 / len(paths)), 1.0, known, facing, course, classes, share, turn_share
        )


def flown(study: StudySettings, known_s: float) -> Iterator[tuple[str, RunResult]]:
    """Fly each track of a study, with the noise of each draw; known_s: 0 for the planner as it is."""

    table = value_table(table_configuration(study.aircraft(), study.requirement()))
    for number in study.numbers:
        flown_by = scene(study, number)
        truth = flown_by.target.sampled(STEP_S * np.arange(round(flown_by.duration_s / STEP_S)))

        def make(
            aircraft: Aircraft, wanted: Requirement, _plans: PlanCheck, truth: np.ndarray = truth
        ) -> PredictivePlanner:
            planner = PredictivePlanner(aircraft, wanted, table)
            return Clairvoyant(planner, truth, known_s) if known_s else planner

        yield study.tracks[number % study.runs].name, fly(study, number, make)


def study_of(folder: Path, airspeed_m_s: float, radius_m: float, speed_max_m_s: float, draws: int) -> StudySettings:
    tracks = recorded_targets([folder], speed_max_m_s).flown
    return StudySettings(
        (PREDICTIVE,),
        len(tracks),
        config=studied(airspeed_m_s=airspeed_m_s, radius_m=radius_m, target_speed_max_m_s=speed_max_m_s),
        tracks=tracks,
        noise_draws=draws,
    )


def shown(study: StudySettings, worst: int = 0, known_s: float = math.inf) -> tuple[float, float]:
    """Print means and worst tracks of the planner as it is and of one which is reported; return the means."""
    by_track: dict[str, list[list[float]]] = {}
    for k, ahead_s in enumerate((0.0, known_s)):
        for name, result in flown(study, ahead_s):
            by_track.setdefault(name, [[], []])[k].append(result.time_on_side)
    sides = {name: np.nanmean(pair, axis=1) for name, pair in by_track.items()}
    mean, least = np.nanmean([*sides.values()], axis=0), np.nanmin([*sides.values()], axis=0)
    print(
        f"\n{len(sides)} tracks: on side {mean[0]:.4f}, worst {least[0]:.3f}; predicted {mean[1]:.4f}, {least[1]:.3f}"
    )
    for name in sorted(sides, key=lambda one: sides[one][0])[:worst]:
        print(f"  {name}: {sides[name][0]:.3f}, predicted {sides[name][1]:.3f}")
    return float(mean[0]), float(mean[1])


def test_knowing_the_future_helps():
    own, predicted = shown(study_of(OWN, 12.0, 40.0, 5.0, 1), worst=5)
    assert predicted > own


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    for name in ("airspeed", "radius", "target-speed-max"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--worst", type=int, default=12)
    parser.add_argument("--known", type=float, default=math.inf)
    given = parser.parse_args()
    study = study_of(given.folder, given.airspeed, given.radius, given.target_speed_max, given.draws)
    shown(study, given.worst, given.known)


if __name__ == "__main__":
    main()

"""How well recorded targets are watched by one who knows what they will do: the gap is the price of not knowing.

    python tests/bench/test_clairvoyance.py FOLDER --airspeed 12 --radius 40 --target-speed-max 5 [--draws N]
    python -m pytest -s tests/bench/test_clairvoyance.py

The planner is the predictive one, with the same moves, prices and noisy filter, but with one future, the true one. It
looks over 30 s, and its watch course is the one that is judged. So it is no bound of what can be flown at all, but of
what a better forecast could bring this planner.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

from app.study.course import LONG, course_made_good_rad
from app.study.flight import CompiledFlight, Flown
from app.study.judging import RunResult
from app.study.recorded import recorded_targets
from app.study.run import run
from app.study.settings import PlannerName, StudySettings
from app.value_cache import value_table
from mission.predictive._decision_kernel import Looker
from mission.predictive._future_kernel import FORETOLD_S, fill_classes
from mission.predictive._rollout_kernel import Futures
from mission.predictive._scene_kernel import Scene
from mission.predictive.planner import PredictivePlanner, PredictiveSettings, table_configuration

OWN = Path(__file__).parents[1] / "data" / "targets"
STEP_S, LOOKED_S = 0.1, 30.0


class Clairvoyant(PredictivePlanner):
    """truth (n, 5): of the target, each STEP_S."""

    def __init__(self, planner: PredictivePlanner, truth: np.ndarray) -> None:
        settings = replace(PredictiveSettings(), horizon_s=LOOKED_S)
        super().__init__(planner._aircraft, planner._requirement, *planner._tables, settings)
        self._place = truth[:, :2]
        self._course_rad = course_made_good_rad(truth[:, 0], truth[:, 1], STEP_S, *LONG)

    def _futures(self, scene: Scene, looker: Looker) -> Futures:
        k = min(FORETOLD_S, math.ceil(8.0 * scene.radius_m / scene.air.airspeed_m_s) + 40)
        first = round(scene.departure_s / STEP_S)
        at = np.minimum(first + round(1.0 / STEP_S) * np.arange(k + 1), len(self._place) - 1)
        off = self._place[at] - (scene.frame_east_m, scene.frame_north_m)
        sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
        place = np.stack([scene.mirror * (off[:, 0] * cos_c - off[:, 1] * sin_c), off @ (sin_c, cos_c)], axis=1)
        velocity = np.diff(place, axis=0)
        facing_rad = scene.mirror * (self._course_rad[at[:k]] - scene.course_rad)
        moving = np.hypot(*velocity.T) > 0.5
        course_rad = np.where(moving, np.arctan2(*velocity.T), facing_rad)
        classes, share, turn_share = np.zeros((1, k, 4), np.int64), np.zeros((1, k, 4)), np.zeros((1, k, 4))
        for i, speed_m_s in enumerate(np.hypot(*velocity.T).tolist()):
            fill_classes(looker.motions, 0.0, speed_m_s, 0.0, 0.0, classes[0, i], share[0, i], turn_share[0, i])
        facing = np.stack([np.sin(facing_rad), np.cos(facing_rad), np.zeros(k)], axis=1)
        course = np.stack([np.sin(course_rad), np.cos(course_rad), course_rad], axis=1)
        known = np.concatenate([place[:k], velocity], axis=1)
        return Futures(np.ones(1), 1.0, known[None], facing[None], course[None], classes, share, turn_share)


def _foreseen(self: CompiledFlight, planner: PredictivePlanner, latency_s: float) -> Flown:
    return self.with_planner(Clairvoyant(planner, self._target.sampled), latency_s)


def flown(study: StudySettings, foreseen: bool) -> Iterator[tuple[str, RunResult]]:
    """Fly each track of a study, with the noise of each draw."""
    table = value_table(table_configuration(study.aircraft(), study.requirement()))
    way = _foreseen if foreseen else CompiledFlight.with_predictive
    with mock.patch.object(CompiledFlight, "with_predictive", way):
        for number in study.numbers:
            yield study.tracks[number % study.runs].name, run(study, PlannerName.PREDICTIVE, number, table)


def study_of(folder: Path, airspeed_m_s: float, radius_m: float, speed_max_m_s: float, draws: int) -> StudySettings:
    tracks = recorded_targets([folder], speed_max_m_s).flown
    return StudySettings(
        (PlannerName.PREDICTIVE,),
        len(tracks),
        target_speed_max_m_s=speed_max_m_s,
        airspeed_m_s=airspeed_m_s,
        still_air_radius_m=radius_m,
        tracks=tracks,
        noise_draws=draws,
    )


def told(study: StudySettings, worst: int = 0) -> tuple[float, float]:
    """Print means and worst tracks of both; return the means."""
    by_track: dict[str, list[list[float]]] = {}
    for k, foreseen in enumerate((False, True)):
        for name, result in flown(study, foreseen):
            by_track.setdefault(name, [[], []])[k].append(result.time_on_side)
    sides = {name: np.nanmean(pair, axis=1) for name, pair in by_track.items()}
    mean, least = np.nanmean([*sides.values()], axis=0), np.nanmin([*sides.values()], axis=0)
    print(
        f"\n{len(sides)} tracks: on side {mean[0]:.4f}, worst {least[0]:.3f}; foreseen {mean[1]:.4f}, {least[1]:.3f}"
    )
    for name in sorted(sides, key=lambda one: sides[one][0])[:worst]:
        print(f"  {name}: {sides[name][0]:.3f}, foreseen {sides[name][1]:.3f}")
    return float(mean[0]), float(mean[1])


def test_knowing_the_future_helps():
    own, foreseen = told(study_of(OWN, 12.0, 40.0, 5.0, 1), worst=5)
    assert foreseen > own


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    for name in ("airspeed", "radius", "target-speed-max"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--worst", type=int, default=12)
    given = parser.parse_args()
    told(study_of(given.folder, given.airspeed, given.radius, given.target_speed_max, given.draws), given.worst)


if __name__ == "__main__":
    main()

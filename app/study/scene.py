"""What a run is flown against: a target, and where the start and the noise come from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sidelong.app.simulation.target import RandomTarget
from sidelong.app.study.recorded import RecordedTarget
from sidelong.app.study.settings import StudySettings
from sidelong.mission.route.route import Route


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The same for every planner."""

    name: str
    target: RandomTarget | RecordedTarget
    duration_s: float
    start_rng: np.random.Generator
    sensor_rng: np.random.Generator
    route: Route | None = None


def scene(settings: StudySettings, number: int) -> Scene:
    """Return the scene of a run, one of ``settings.numbers``."""
    draw, k = divmod(number, settings.runs)
    if not settings.tracks:
        seeds = np.random.SeedSequence((settings.seed, k)).spawn(3)
        target = RandomTarget(
            np.random.default_rng(seeds[0]), settings.duration_s, settings.target_speed_max_m_s, settings.legs_s
        )
        start, sensor = np.random.SeedSequence((settings.seed, k, draw)).spawn(2) if draw else seeds[1:]
        return Scene(
            f"random {k}", target, settings.duration_s, np.random.default_rng(start), np.random.default_rng(sensor)
        )
    track = settings.tracks[k]
    start, sensor = np.random.SeedSequence((settings.seed, track.key, draw)).spawn(2)
    duration_s = min(track.duration_s, settings.duration_s)
    return Scene(
        track.name, track, duration_s, np.random.default_rng(start), np.random.default_rng(sensor), track.route
    )

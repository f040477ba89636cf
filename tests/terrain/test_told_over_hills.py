"""What is shown of a flight over hills without a truth: sight and clearance in the summary."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sidelong.app.analysis.summary import SummaryCollector
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.requirement import Aircraft, Requirement, Side

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0)


def snapshot(time_s: float, aircraft_m: tuple[float, float, float], target_m: tuple[float, float]) -> SimpleNamespace:
    return SimpleNamespace(
        target="",
        turn_payload=False,
        time_s=time_s,
        moves=0,
        silent_s=0.0,
        position_age_s=0.0,
        health=(),
        unknown="",
        breach="",
        requirement=REQUIREMENT,
        airframe=Aircraft(15.0, 50.0),
        aircraft=SimpleNamespace(east_m=aircraft_m[0], north_m=aircraft_m[1]),
        height_m=aircraft_m[2],
        estimate=SimpleNamespace(
            time_s=time_s, east_m=target_m[0], north_m=target_m[1], velocity_east_m_s=1.0, velocity_north_m_s=0.0
        ),
    )


def test_sight_and_clearance_are_reported_without_a_truth() -> None:
    heights_m = np.zeros((41, 41), np.float32)
    heights_m[:, 20] = 80.0  # a ridge along the middle, 20 m to either side
    ground = Ground(heights_m, -400.0, -400.0, 20.0, 20.0)
    collector = SummaryCollector(REQUIREMENT)
    collector.observe(snapshot(0.0, (-200.0, 0.0, 50.0), (200.0, 0.0)))  # before the ground was known
    collector.ground = ground
    for time_s, aircraft_m in (
        (1.0, (-200.0, 0.0, 10.0)),  # behind the ridge, and low; before the watch begins
        (2.0, (-200.0, 0.0, 60.0)),  # behind the ridge
        (3.0, (-40.0, 0.0, 200.0)),  # above it
        (4.0, (100.0, 0.0, 60.0)),  # on the target's side
        (5.0, (0.0, 0.0, 130.0)),  # over the ridge itself
    ):
        collector.observe(snapshot(time_s, aircraft_m, (200.0, 0.0)))  # type: ignore[arg-type]
    assert collector.over_ground(2.0) == (0.75, pytest.approx(50.0))
    assert SummaryCollector(REQUIREMENT).over_ground(0.0) == (None, None)

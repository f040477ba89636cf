from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sidelong.app.flight.point_payload import PayloadPointer
from sidelong.estimators.estimate import TrackQuality
from sidelong.mission.control.snapshot import Phase
from tests.faults.flight import FaultedFlight, Scenario

_HEIGHT_M = 100.0


@pytest.fixture(scope="module")
def snapshot():
    loop = FaultedFlight(Scenario(seed=2, flavour="arduplane", duration_s=30.0))
    loop.fly()
    return loop.controller.snapshot()


def pointed(*snapshots, heading_rad: float | None = 0.7) -> list[tuple[float, float]]:
    commands: list[tuple[float, float]] = []
    pointer = PayloadPointer(lambda pitch_rad, yaw_rad: commands.append((pitch_rad, yaw_rad)), lambda: heading_rad)
    for one in snapshots:
        pointer.show(one)
    return commands


def test_gimbal_is_pointed_at_the_estimate_relative_to_the_heading(snapshot):
    ((pitch_rad, yaw_rad),) = pointed(snapshot)
    aircraft, (east_m, north_m) = snapshot.aircraft, snapshot.estimate.position_m(snapshot.time_s)
    level_m = _HEIGHT_M / math.tan(-pitch_rad)
    there_m = (
        aircraft.east_m + level_m * math.sin(yaw_rad + 0.7),
        aircraft.north_m + level_m * math.cos(yaw_rad + 0.7),
    )
    assert there_m == pytest.approx((east_m, north_m), abs=0.5)


def test_gimbal_is_commanded_five_times_a_second_at_most(snapshot):
    assert len(pointed(*(replace(snapshot, time_s=snapshot.time_s + 0.05 * step) for step in range(20)))) == 5


def test_nothing_is_commanded_without_control_target_or_heading(snapshot):
    lost = replace(snapshot.estimate, quality=TrackQuality.LOST)
    for unfit in (replace(snapshot, phase=phase) for phase in (Phase.WAITING, Phase.YIELDED, Phase.ENDED)):
        assert pointed(unfit) == []
    assert pointed(replace(snapshot, estimate=None), replace(snapshot, estimate=lost)) == []
    assert pointed(snapshot, heading_rad=None) == []

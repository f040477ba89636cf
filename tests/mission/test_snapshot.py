"""What an operator sees of the vehicle and its payload."""

from __future__ import annotations

import math

from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.mission.control.controller import StandoffController

LASER, DOWNWARD = Source("DISTANCE_SENSOR", 154, 1, 100), Source("DISTANCE_SENSOR", 1, 0, 25)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
NORTH_AND_DOWN = (math.cos(-0.2), 0.0, math.sin(-0.2), 0.0)  # pitched down by 0.4 rad


def controller() -> StandoffController:
    return prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()


def second(time_s: float, slant_range_m: float) -> tuple[object, ...]:
    return (
        PositionReading(time_s, 0.0, 15.0 * time_s, 120.0, 0.0, 15.0, 0.0),
        AttitudeReading(time_s, 0.3, 0.0, 0.0),
        GimbalReading(time_s, NORTH_AND_DOWN, "earth", GIMBAL),
        RangeReading(time_s, slant_range_m, LASER),
    )


def shown(core: StandoffController, *readings: object):
    for reading in readings:
        core.step(reading)
    return core.snapshot()


def test_gauges_begin_empty():
    now = controller().snapshot()
    assert now.range_s == now.gimbal_s == -math.inf
    assert math.isnan(now.nis)
    assert math.isnan(now.height_m)
    assert now.range_m is now.angle_rad is now.in_band is now.on_side is None


def test_gauges_follow_the_devices_in_use():
    now = shown(controller(), *second(1.0, 308.0), *second(2.0, 308.0), RangeReading(5.0, 120.0, DOWNWARD))
    assert (now.range_s, now.gimbal_s) == (2.0, 2.0)
    assert (now.attitude.roll_rad, now.height_m) == (0.3, 120.0)


def test_an_absurd_range_shows_as_a_rejected_sighting_of_large_innovation():
    core = controller()
    for tick in range(20):
        before = shown(core, *second(0.1 * tick, 308.0))
    after = shown(core, *second(2.0, 600.0), *second(2.1, 308.0)[:3])
    assert before.sightings - before.rejected > 10
    assert after.rejected == 1
    assert before.nis < 20.0 < after.nis

"""The compiled loop of the studies against the same run measured and decided by the classes that fly."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.analysis.score import within_pan_limits
from sidelong.app.simulation.airframe_kernel import Airframe, Body
from sidelong.app.simulation.target import TargetTruth
from sidelong.app.study import flight as compiled_flight
from sidelong.app.study import run as study_run
from sidelong.app.study.flight import can_fly
from sidelong.app.study.flight_kernel import within_pan
from sidelong.app.study.run import run
from sidelong.app.study.settings import PlannerName, StudySettings, studied
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.predictive.planner import table_configuration
from sidelong.mission.predictive.value_iteration import compute

SETTINGS = StudySettings(runs=8, duration_s=400.0)


def a_table(settings):
    configuration = table_configuration(
        settings.aircraft(), settings.requirement(), settings.config.simulation.wind_speed_m_s
    )
    return compute(replace(configuration, cells=10, improvements=(2, 1)))


def step_by_step(monkeypatch, settings, planner, number, table):
    """Fly the run as with other filters and payloads: pairing, filter and planner are the classes."""
    with monkeypatch.context() as patched:
        patched.setattr(compiled_flight, "can_fly", lambda settings: False)
        return run(settings, planner, number, table, keep_track=True)


def assert_same(one, other):
    assert one.moves_per_hour == other.moves_per_hour
    for name in ("aircraft_m", "target_m"):
        np.testing.assert_allclose(getattr(one.track, name), getattr(other.track, name), atol=1e-6)
    np.testing.assert_allclose(one.track.judged.observation_rad, other.track.judged.observation_rad, atol=1e-6)
    for name in ("time_in_band", "time_on_side", "time_on_side_now", "reversals_per_hour"):
        assert getattr(one, name) == getattr(other, name)
    assert one.min_range_m == pytest.approx(other.min_range_m, abs=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        SETTINGS,
        replace(SETTINGS, config=studied(side="right"), lag_s=0.5, latency_s=1.0),
        replace(SETTINGS, config=studied(side="either"), perfect_sensors=True),
        replace(SETTINGS, config=studied(side="120-200")),
        replace(SETTINGS, config=studied(radius_m=84.5, wind_speed_m_s=3.0, wind_from_deg=200.0)),
        replace(SETTINGS, config=studied(pan_limit_deg=120.0, wind_speed_m_s=2.0, wind_from_deg=200.0)),
    ],
    ids=["left", "right", "either", "sector", "wind", "pan limits"],
)
def test_the_compiled_loop_flies_what_the_classes_fly(monkeypatch, settings):
    table = a_table(settings)
    moves = 0.0
    for number in range(2):
        flown = run(settings, PlannerName.PREDICTIVE, number, table, keep_track=True)
        assert_same(flown, step_by_step(monkeypatch, settings, PlannerName.PREDICTIVE, number, table))
        moves += flown.moves_per_hour
    assert moves > 0.0


@pytest.mark.parametrize("planner", [PlannerName.PAPER, PlannerName.LVFG, PlannerName.PARK, PlannerName.ORBIT])
def test_other_planners_fly_in_it_too(monkeypatch, planner):
    flown = run(SETTINGS, planner, 1, None, keep_track=True)
    assert_same(flown, step_by_step(monkeypatch, SETTINGS, planner, 1, None))


def test_the_loop_and_the_judge_agree_on_what_the_gimbal_can_look_at():
    rng, wind = np.random.default_rng(4), (2.0, -3.0)
    for _ in range(200):
        course_rad, limit_rad = rng.uniform(-math.pi, math.pi), rng.uniform(1.6, 3.1)
        body = Body(0.0, *rng.uniform(-300.0, 300.0, 2), course_rad, 12.0, 0.0, 0.0)
        east_m, north_m = rng.uniform(-300.0, 300.0, 2)
        frame = Airframe(12.0, 0.5, 0.5, 1.0, *wind)
        nose = 12.0 * math.sin(course_rad) - wind[0], 12.0 * math.cos(course_rad) - wind[1]
        places = np.array([[body.east_m, body.north_m]]), np.array([[east_m, north_m]])
        (judged,) = within_pan_limits(*places, np.array([math.atan2(*nose)]), limit_rad)
        assert within_pan(body, frame, east_m, north_m, math.cos(limit_rad)) == judged


class Jumping:
    """A target that is suddenly somewhere else, as after a wrong lock of the gimbal."""

    def __init__(self, jumps_m):
        self._jumps_m = jumps_m

    def sampled(self, time_s):
        east_m = np.zeros_like(time_s)
        for from_s, to_s, by_m in self._jumps_m:
            east_m[(time_s > from_s) & (time_s < to_s)] += by_m
        return np.stack([east_m + 2.0 * time_s, 0.0 * time_s, 2.0 + 0.0 * time_s, 0.0 * time_s, east_m], axis=1)

    def at(self, time_s):
        return TargetTruth(*self.sampled(np.array([time_s]))[0].tolist())


@pytest.mark.parametrize("jumps_m", [[(20.0, 99.0, 120.0)], [(20.0, 20.35, 90.0), (30.0, 33.0, -80.0)]])
def test_a_track_that_begins_again_does_so_in_the_compiled_loop(monkeypatch, jumps_m):
    settings = replace(SETTINGS, duration_s=60.0)
    made = study_run.scene
    monkeypatch.setattr(study_run, "scene", lambda *of: replace(made(*of), target=Jumping(jumps_m), duration_s=60.0))
    reconsidered = []
    reconsider = compiled_flight.CompiledFlight._reconsider
    monkeypatch.setattr(
        compiled_flight.CompiledFlight, "_reconsider", lambda self: (reconsidered.append(1), reconsider(self))
    )
    flown = run(settings, PlannerName.LVFG, 1, None, keep_track=True)
    assert reconsidered
    assert_same(flown, step_by_step(monkeypatch, settings, PlannerName.LVFG, 1, None))


def test_what_the_loop_cannot_measure_with_is_measured_with_outside():
    assert can_fly(TrackerSettings())
    for other in (
        TrackerSettings(filter="ekf"),
        TrackerSettings(gimbal_latency_s=0.2),
        TrackerSettings(lever_arm_body_m=(0.0, 0.0, 1.0)),
        TrackerSettings(mount_roll_pitch_yaw_rad=(0.0, math.pi, 0.0)),
    ):
        assert not can_fly(other)
    settings = replace(SETTINGS, duration_s=30.0, config=studied(filter="ekf"))
    flown = run(settings, PlannerName.LVFG, 1, None)
    assert 100.0 < flown.min_range_m < 500.0

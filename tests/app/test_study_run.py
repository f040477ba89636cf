import math

import numpy as np
import pytest

from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.simulation.payload import PayloadErrors
from sidelong.app.simulation.target import RandomTarget
from sidelong.app.study.design import designs
from sidelong.app.study.flight import CompiledFlight, Sensed
from sidelong.app.study.run import run
from sidelong.app.study.settings import PlannerName, StudySettings
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Decision
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement, Side, Wind
from sidelong.mission.paper.planner import PaperPlanner

PAPER_AIRCRAFT = Aircraft(10.0, 50.0)
BANK_RAD = math.atan(1.1 * 10.0**2 / (GRAVITY_M_S2 * 50.0))


class Eastward:
    """Drives straight east from the origin."""

    def __init__(self, speed_m_s):
        self.speed_m_s = speed_m_s

    def sampled(self, time_s):
        still = 0.0 * time_s
        return np.stack([self.speed_m_s * time_s, still, self.speed_m_s + still, still, math.pi / 2 + still], axis=1)


def body_on(circle, course_rad, wind=None):
    state = AircraftState(0.0, *circle.position_at_course(course_rad), course_rad, 10.0, circle.curvature_per_m)
    return KinematicAircraft(state, 10.0, BANK_RAD, math.radians(30.0), wind or Wind())


def test_a_random_target_keeps_to_its_rules():
    target = RandomTarget(np.random.default_rng(3), 5000.0, 5.0, (40.0, 200.0))
    truths = [target.at(t) for t in np.arange(0.0, 5000.0)]
    speed = np.array([math.hypot(t.velocity_east_m_s, t.velocity_north_m_s) for t in truths])
    place = np.array([(t.east_m, t.north_m) for t in truths])
    assert np.hypot(*np.diff(place, axis=0).T).max() <= 5.0 + 1e-9
    standing = speed < 0.3
    assert 0.1 < standing.mean() < 0.6
    assert np.all((speed[~standing] >= 1.0) & (speed <= 5.0 + 1e-9)[~standing])
    course = np.array([t.course_rad for t in truths])
    kept = np.flatnonzero(standing[1:])
    np.testing.assert_array_equal(course[kept + 1], course[kept])
    changes = np.flatnonzero(np.diff(speed) != 0.0)
    assert np.diff(changes).min() >= 39.0


def test_a_random_target_is_the_seeds_alone():
    one, same, other = (RandomTarget(np.random.default_rng(k), 1000.0, 5.0, (40.0, 200.0)) for k in (1, 1, 2))
    assert one.at(777.0) == same.at(777.0)
    assert one.at(777.0) != other.at(777.0)


def flight_alongside(speed_m_s, circle, course_rad, duration_s, wind=None, perfect=True):
    """A flight 100 m above a target that drives straight east."""
    errors, wind = PayloadErrors(), wind or Wind()
    given = TrackerSettings(
        range_sigma_m=errors.range_sigma_m,
        yaw_sigma_rad=errors.angle_sigma_rad,
        pitch_sigma_rad=errors.angle_sigma_rad,
    )
    sensed, body = Sensed(errors, given, np.random.default_rng(1), perfect), body_on(circle, course_rad, wind)
    return CompiledFlight(Eastward(speed_m_s), body, circle, 100.0, sensed, wind, duration_s)


class Staying:
    """Never moves."""

    def decide(self, aircraft, target, present, wind, latency_s):
        return Decision(aircraft.time_s, None, "staying")


@pytest.mark.parametrize("wind", [Wind(), Wind(3.0, -1.0)])
def test_the_aircraft_holds_a_circle_over_the_ground(wind):
    flight = flight_alongside(0.0, Circle(0.0, 0.0, 90.0, clockwise=False), 0.3, 200.0, wind)
    log = flight.with_planner(Staying(), 0.0).log
    np.testing.assert_allclose(np.hypot(log[:, 1], log[:, 2]), 90.0, atol=1.5)


def test_bank_and_roll_rate_are_limited():
    body = body_on(Circle(0.0, 0.0, 50.0, clockwise=True), 0.0)
    banks = []
    for _ in range(100):
        body.step(-1.0, 0.1)
        banks.append(body.body.bank_rad)
    assert min(banks) == pytest.approx(-BANK_RAD)
    assert np.abs(np.diff(banks)).max() <= math.radians(3.0) + 1e-12


def test_the_filter_finds_the_target_through_noise_and_bias():
    estimates = []

    def circling(aircraft, estimate):
        estimates.append(estimate)
        return 1.0 / 50.0

    flight_alongside(3.0, Circle(0.0, 250.0, 50.0, clockwise=True), 0.0, 60.0, perfect=False).with_law(circling)
    last = estimates[-1]
    assert last.time_s > 59.0
    assert math.hypot(last.east_m - 3.0 * last.time_s, last.north_m) < 4.0
    assert math.hypot(last.velocity_east_m_s - 3.0, last.velocity_north_m_s) < 0.5


def the_papers_example(threshold):
    """Section 7: the target drives straight east at 3 m/s, the aircraft starts at (0, 100) m on its left."""
    requirement = Requirement(100.0, 500.0, Side.LEFT, 3.0, threshold)
    flight = flight_alongside(3.0, Circle(0.0, 150.0, 50.0, clockwise=True), -math.pi / 2, 1500.0)
    return flight.with_planner(PaperPlanner(PAPER_AIRCRAFT, requirement), 0.0).log


def test_the_papers_coincidences_come_out_of_the_study_too():
    flown = {threshold: the_papers_example(threshold) for threshold in (0.8, 0.9, 1.0, 1.1, 1.2)}
    max_m = {0.8: 467.0, 0.9: 467.0, 1.0: 504.0, 1.1: 504.0, 1.2: 601.0}
    np.testing.assert_array_equal(flown[0.8], flown[0.9])
    np.testing.assert_array_equal(flown[1.0], flown[1.1])
    assert np.abs(flown[0.9] - flown[1.0]).max() > 100.0
    assert np.abs(flown[1.1] - flown[1.2]).max() > 100.0
    for threshold, log in flown.items():
        range_m = np.hypot(log[:, 1] - log[:, 3], log[:, 2] - log[:, 4])
        assert range_m.min() == pytest.approx(100.0, abs=3.0)
        assert range_m.max() == pytest.approx(max_m[threshold], abs=6.0)


def test_target_and_noise_are_the_same_for_every_planner():
    settings = StudySettings(perfect_sensors=True, duration_s=120.0)
    field, park = (
        run(settings, name, 5, None, keep_track=True).track for name in (PlannerName.LVFG, PlannerName.PARK)
    )
    np.testing.assert_array_equal(field.target_m, park.target_m)
    assert field.judged.range_m[0] == park.judged.range_m[0]
    assert 240.0 < field.judged.range_m[0] < 360.0


@pytest.mark.parametrize(("wind_m_s", "radius_m"), [(0.0, 50.0), (3.0, 84.5)])
def test_wind_grows_the_circle(wind_m_s, radius_m):
    (found,) = designs(StudySettings(), {"simulation": {"wind_speed_m_s": wind_m_s}}, [])
    assert found.settings.aircraft().radius_m == pytest.approx(radius_m)
    assert found.settings.still_air_radius_m == 50.0

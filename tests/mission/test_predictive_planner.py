import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Side, Wind
from sidelong.mission.fleet.team_planner import IN_TEAM
from sidelong.mission.geometry.line_kernel import craft_of, sharpness_per_m2
from sidelong.mission.geometry.progress import ground_speed_m_s, ground_speeds_m_s, nearest_arc_m, point_at
from sidelong.mission.predictive.planner import (
    USUAL,
    PredictivePlanner,
    PredictiveSettings,
    table_configuration,
)
from sidelong.mission.viewpoint.watch_course import watching_from

CALM = Wind()
LATENCY_S = 0.5


def seen(time_s, place, velocity, sigma_m=0.5, quality=TrackQuality.GOOD, last_sighting_s=None):
    covariance = np.diag([sigma_m**2, sigma_m**2, (0.1 * sigma_m) ** 2, (0.1 * sigma_m) ** 2])
    last_s = time_s if last_sighting_s is None else last_sighting_s
    return TargetEstimate(time_s, *place, *velocity, covariance, quality, last_s)


def straight(velocity):
    return lambda time_s: ((velocity[0] * time_s, velocity[1] * time_s), velocity)


def turning_back(velocity, turn_s, turn_rad=math.pi):
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    after = velocity[0] * cos_t + velocity[1] * sin_t, velocity[1] * cos_t - velocity[0] * sin_t

    def at(time_s):
        since_s = max(time_s - turn_s, 0.0)
        before_s = min(time_s, turn_s)
        place = tuple(v * before_s + w * since_s for v, w in zip(velocity, after, strict=True))
        return place, (after if time_s >= turn_s else velocity)

    return at


class Flight:
    """Flies a planner's plans exactly, in steps of half a second, with a decision every second."""

    def __init__(self, planner, circle, course_rad, wind=CALM, airspeed_m_s=10.0):
        self.planner, self.wind, self.airspeed_m_s = planner, wind, airspeed_m_s
        self.present, self.coming = Plan(circle), None
        east_m, north_m = circle.position_at_course(course_rad)
        self.aircraft = AircraftState(
            0.0, east_m, north_m, course_rad, ground_speed_m_s(course_rad, airspeed_m_s, wind), circle.curvature_per_m
        )
        self.plans, self.reasons = [], []

    def fly(self, target_at, duration_s, step_s=0.5):
        """Return target-relative places (n, 2) and target velocities (n, 2)."""
        relative, velocities = [], []
        for k in range(round(duration_s / step_s)):
            place, velocity = target_at(self.aircraft.time_s)
            relative.append((self.aircraft.east_m - place[0], self.aircraft.north_m - place[1]))
            velocities.append(velocity)
            if self.coming is None and k % round(1.0 / step_s) == 0:
                decision = self.planner.decide(
                    self.aircraft, seen(self.aircraft.time_s, place, velocity), self.present, self.wind, LATENCY_S
                )
                self.reasons.append(decision.reason)
                if decision.plan is not None:
                    self.coming = decision.plan
                    self.plans.append((self.present, self.aircraft, decision.plan))
            self._step(step_s)
        return np.array(relative), np.array(velocities)

    def _step(self, step_s):
        arc_m = nearest_arc_m(self.present, self.aircraft)
        point = point_at(self.present, arc_m + self.aircraft.ground_speed_m_s * step_s, self.aircraft)
        time_s = self.aircraft.time_s + step_s
        if self.coming is not None and time_s >= self.coming.departure_s - 1e-9:
            self.present, self.coming = self.coming, None
            point = point_at(self.present, 0.0, self.aircraft)
        speed_m_s = ground_speed_m_s(point.course_rad, self.airspeed_m_s, self.wind)
        self.aircraft = AircraftState(
            time_s,
            point.east_m,
            point.north_m,
            math.remainder(point.course_rad, 2.0 * math.pi),
            speed_m_s,
            point.curvature_per_m,
        )


def side_share(relative, velocities, side):
    """Return the share of the time on a side of a target that always moves."""
    right = relative[:, 0] * velocities[:, 1] - relative[:, 1] * velocities[:, 0]
    return float(np.mean(right > 0.0 if side is Side.RIGHT else right < 0.0))


ALONGSIDE = Circle(-250.0, 0.0, 50.0, clockwise=True)  # on the left of a target at the origin that moves north


@pytest.fixture
def planner(paper_aircraft, paper_requirement, paper_table):
    return PredictivePlanner(paper_aircraft, paper_requirement, paper_table)


def assert_flyable(plan, present, aircraft, airframe, wind=CALM):
    """No part is tighter than the circle, and the roll rate is what the airframe's ramp allows at its speed."""
    radius_m = airframe.radius_m
    path = plan.transition
    assert plan.departure_s == pytest.approx(aircraft.time_s + LATENCY_S)
    start = point_at(present, nearest_arc_m(present, aircraft) + aircraft.ground_speed_m_s * LATENCY_S, aircraft)
    assert (path.east_m[0], path.north_m[0]) == pytest.approx((start.east_m, start.north_m), abs=1e-6)
    assert path.curvature_per_m[0] == pytest.approx(start.curvature_per_m, abs=1e-9)
    assert np.abs(path.curvature_per_m).max() <= 1.0 / radius_m + 1e-9
    speed_m_s = ground_speeds_m_s(0.5 * (path.course_rad[1:] + path.course_rad[:-1]), airframe.airspeed_m_s, wind)
    ramps = np.array([sharpness_per_m2(one, craft_of(airframe)) for one in speed_m_s])
    assert np.all(np.abs(np.diff(path.curvature_per_m)) <= 1.01 * ramps * np.diff(path.arc_m) + 1e-12)
    end_m = math.hypot(path.east_m[-1] - plan.circle.east_m, path.north_m[-1] - plan.circle.north_m)
    assert end_m == pytest.approx(radius_m, abs=1e-6)
    assert path.curvature_per_m[-1] == pytest.approx(plan.circle.curvature_per_m, abs=1e-9)


def test_keeps_up_with_a_target_that_drives_straight(planner):
    flight = Flight(planner, ALONGSIDE, 0.0)
    relative, velocities = flight.fly(straight((0.0, 4.0)), 600.0)
    range_m = np.hypot(*relative.T)
    assert range_m.min() > 100.0
    assert range_m.max() < 500.0
    assert side_share(relative, velocities, Side.LEFT) == 1.0
    assert 2 <= len(flight.plans) <= 15


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.floats(1.0, 5.0),
    st.floats(60.0, 120.0),
    st.floats(-math.pi, math.pi),
    st.sampled_from([math.pi, math.pi, math.pi / 2, -math.pi / 2, 2.5]),
)
def test_a_target_that_turns_back_is_never_approached_or_crossed(planner, speed_m_s, turn_s, course_rad, turn_rad):
    planner = fresh(planner)
    flight = Flight(planner, ALONGSIDE, course_rad)
    relative, velocities = flight.fly(turning_back((0.0, speed_m_s), turn_s, turn_rad), turn_s + 180.0)
    range_m = np.hypot(*relative.T)
    assert range_m.min() >= 100.0
    assert range_m.max() <= 500.0
    assert side_share(relative[-120:], velocities[-120:], Side.LEFT) == 1.0  # back on the side after two minutes
    for present, aircraft, plan in flight.plans:
        assert_flyable(plan, present, aircraft, planner.aircraft)


def fresh(planner):
    """A planner without memory of earlier examples."""
    return PredictivePlanner(planner.aircraft, planner.requirement, planner.tables[0])


def test_right_is_the_mirror_of_left(paper_aircraft, paper_requirement, paper_table):
    flights = []
    for side, sign in ((Side.LEFT, 1.0), (Side.RIGHT, -1.0)):
        requirement = replace(paper_requirement, side=side)
        circle = replace(ALONGSIDE, east_m=sign * ALONGSIDE.east_m, clockwise=side.clockwise)
        flight = Flight(PredictivePlanner(paper_aircraft, requirement, paper_table), circle, sign * 0.7)
        relative, _ = flight.fly(turning_back((0.0, 4.0), 40.0), 120.0)
        flights.append(relative * (sign, 1.0))
    np.testing.assert_allclose(flights[0], flights[1], atol=0.01)


def test_a_change_under_way_is_continuous(planner, paper_aircraft):
    flight = Flight(planner, ALONGSIDE, 0.0)
    while flight.present.transition is None:
        flight.fly(straight((0.0, 4.5)), 1.0)
    # The target turns back while the aircraft is on its way.
    flight.fly(turning_back((0.0, 4.5), flight.aircraft.time_s), 120.0)
    under_way = 0
    for present, aircraft, plan in flight.plans:
        assert_flyable(plan, present, aircraft, paper_aircraft)
        if present.transition is not None:
            under_way += nearest_arc_m(present, aircraft) < present.transition.length_m
    assert under_way >= 1


def test_an_aircraft_next_to_its_line_departs_from_the_line(planner, paper_aircraft, on_circle):
    plans = 0
    for course_rad in np.linspace(0.0, 6.0, 25):
        alongside = on_circle(replace(ALONGSIDE, radius_m=53.0), course_rad)
        decision = planner.decide(alongside, seen(0.0, (150.0, 100.0), (3.0, 0.0)), Plan(ALONGSIDE), CALM, LATENCY_S)
        if decision.plan is not None:
            plans += 1
            assert_flyable(decision.plan, Plan(ALONGSIDE), alongside, paper_aircraft)
    assert plans >= 3


def test_an_aircraft_that_left_its_line_departs_from_where_it_is(planner):
    aircraft = AircraftState(0.0, -400.0, 300.0, math.pi, 10.0, 0.5)
    decision = planner.decide(aircraft, seen(0.0, (0.0, 0.0), (0.0, 4.0)), Plan(ALONGSIDE), CALM, 0.0)
    path = decision.plan.transition
    assert (path.east_m[0], path.north_m[0]) == pytest.approx((-400.0, 300.0))
    assert path.curvature_per_m[0] == pytest.approx(1.0 / 50.0)


def test_reasons_report_what_would_happen(planner):
    flight = Flight(planner, ALONGSIDE, 0.0)
    flight.fly(straight((0.0, 5.0)), 100.0)
    moves = [reason for reason in flight.reasons if reason.startswith("moving")]
    stays = [reason for reason in flight.reasons if not reason.startswith("moving")]
    assert all(
        reason.startswith(("staying: the target stays ", "staying until a better moment: in ")) for reason in stays
    )
    assert any("north" in reason and ": in " in reason and " s the target would be " in reason for reason in moves)


def test_a_lost_target_is_not_moved_after(planner):
    aircraft = AircraftState(100.0, -300.0, 0.0, 0.0, 10.0, 0.02)
    lost = seen(100.0, (400.0, 0.0), (5.0, 0.0), quality=TrackQuality.LOST, last_sighting_s=70.0)
    decision = planner.decide(aircraft, lost, Plan(ALONGSIDE), CALM, LATENCY_S)
    assert decision.plan is None
    assert decision.reason == "holding the circle: the target has not been seen for 30 s"
    unseen = seen(100.0, (400.0, 0.0), (5.0, 0.0), quality=TrackQuality.COASTING, last_sighting_s=39.0)
    assert planner.decide(aircraft, unseen, Plan(ALONGSIDE), CALM, LATENCY_S).plan is None


def test_uncertainty_keeps_the_aircraft_further_away(paper_aircraft, paper_requirement, paper_table):
    min_m = []
    for sigma_m in (1.0, 60.0):
        planner = PredictivePlanner(paper_aircraft, paper_requirement, paper_table, PredictiveSettings(1.0, 60.0))
        present = Plan(Circle(-200.0, 0.0, 50.0, clockwise=True))
        aircraft = AircraftState(0.0, -250.0, 0.0, 0.0, 10.0, 0.02)
        target = seen(0.0, (0.0, 0.0), (0.0, 0.0), sigma_m, TrackQuality.COASTING, -20.0)
        decision = planner.decide(aircraft, target, present, CALM, LATENCY_S)
        circle = (decision.plan or present).circle
        min_m.append(math.hypot(circle.east_m, circle.north_m) - 50.0)
    assert min_m[0] == pytest.approx(150.0)
    assert min_m[1] > 200.0


def test_either_side_takes_the_new_one_when_the_target_turns_back(paper_aircraft, paper_requirement, paper_table):
    planner = PredictivePlanner(paper_aircraft, watching_from(paper_requirement, "either"), paper_table)
    flight = Flight(planner, ALONGSIDE, 0.0)
    relative, velocities = flight.fly(turning_back((0.0, 3.0), 60.0), 240.0)
    assert np.hypot(*relative.T).min() >= 100.0
    assert side_share(relative[120:], velocities[120:], Side.RIGHT) == 1.0
    assert flight.present.circle.clockwise is False


def test_a_wind_that_the_table_does_not_know_is_flown_in(paper_requirement, paper_table, paper_aircraft):
    aircraft = replace(paper_aircraft, radius_m=84.5)
    planner = PredictivePlanner(aircraft, paper_requirement, paper_table)
    flight = Flight(planner, replace(ALONGSIDE, radius_m=84.5), 0.0, Wind(3.0, 0.0))
    relative, velocities = flight.fly(straight((0.0, 4.0)), 400.0)
    assert np.hypot(*relative.T).min() >= 100.0
    assert np.hypot(*relative.T).max() <= 500.0
    assert side_share(relative, velocities, Side.LEFT) > 0.9
    for present, state, plan in flight.plans:
        assert_flyable(plan, present, state, aircraft, Wind(3.0, 0.0))


def test_too_strong_a_wind_is_a_reason_to_hold(planner):
    aircraft = AircraftState(0.0, -300.0, 0.0, 0.0, 10.0, 0.02)
    decision = planner.decide(
        aircraft, seen(0.0, (0.0, 0.0), (0.0, 3.0)), Plan(ALONGSIDE), Wind(11.0, 0.0), LATENCY_S
    )
    assert decision.plan is None
    assert "wind" in decision.reason


def test_a_fence_leaves_the_next_best_move_or_none(paper_aircraft, paper_requirement, paper_table, on_circle):
    target = seen(0.0, (150.0, 100.0), (3.0, 0.0))

    def decisions(check):
        planner = PredictivePlanner(paper_aircraft, paper_requirement, paper_table, check=check)
        states = [on_circle(ALONGSIDE, course_rad) for course_rad in np.linspace(0.0, 6.0, 25)]
        return [planner.decide(state, target, Plan(ALONGSIDE), CALM, LATENCY_S) for state in states]

    free = next(k for k, decision in enumerate(decisions(lambda plan: plan)) if decision.plan is not None)
    wanted = decisions(lambda plan: plan)[free].plan.circle
    walled = decisions(lambda plan: "a wall" if plan.circle.east_m > wanted.east_m - 10.0 else plan)[free]
    assert walled.plan is None or walled.plan.circle.east_m <= wanted.east_m - 10.0
    shut = decisions(lambda plan: "the circle crosses keep_out polygon 1")[free]
    assert shut.plan is None
    assert shut.reason == "staying: the circle crosses keep_out polygon 1"


def test_an_overshooting_speed_is_not_accepted(paper_aircraft, paper_requirement, paper_table, on_circle):
    """Right after a turn the estimate reads 7 m/s, give or take 1.5; the target can do 5."""

    def decide(speed_m_s, sigma_m):
        planner = PredictivePlanner(paper_aircraft, paper_requirement, paper_table)
        target = seen(0.0, (0.0, 0.0), (0.0, speed_m_s), sigma_m)
        return planner.decide(on_circle(ALONGSIDE, 1.0), target, Plan(ALONGSIDE), CALM, LATENCY_S).values[
            "move_cost_s"
        ]

    assert decide(7.0, 15.0) == pytest.approx(decide(5.0, 15.0))
    assert decide(7.0, 1.0) != pytest.approx(decide(5.0, 1.0))


def test_the_table_of_a_requirement(paper_aircraft, paper_requirement):
    left = table_configuration(paper_aircraft, paper_requirement)
    assert left == table_configuration(paper_aircraft, replace(paper_requirement, side=Side.RIGHT))
    sector = table_configuration(paper_aircraft, watching_from(paper_requirement, "120-200"))
    assert not sector.follows_course
    assert sector.cost.half_width_rad == pytest.approx(math.radians(40.0))
    standing = table_configuration(paper_aircraft, replace(paper_requirement, target_speed_max_m_s=0.0))
    assert standing.target_speed_max_m_s > 0.0


def test_moves_of_wide_circles_are_costly_but_never_so_costly_that_the_band_is_lost(
    paper_aircraft, paper_requirement
):
    alone, together = (
        [
            table_configuration(
                replace(paper_aircraft, radius_m=radius_m), paper_requirement, 0.0, settings
            ).leave_cost
            for radius_m in (10.0, 50.0, 70.0, 105.0, 150.0)
        ]
        for settings in (USUAL, IN_TEAM)
    )
    assert together[:3] == [4.0, 4.0, 4.0]
    assert alone[:2] == pytest.approx([4.0 * (5.0 / 7.0) ** 1.7] * 2)
    assert alone[2:] == together[2:]
    assert alone[3] == pytest.approx(4.0 * 1.5**1.7)
    assert alone[3] < alone[4] < 1.01 * alone[3]


def begun(planner):
    """Fly until the planner has just departed; return the flight, with the target at 4.5 m/s to the north."""
    flight = Flight(planner, ALONGSIDE, 0.0)
    while flight.present.transition is None:
        flight.fly(straight((0.0, 4.5)), 1.0)
    return flight


def test_a_plan_just_begun_is_left_for_a_large_gain_only_and_reports_so(
    paper_aircraft, paper_requirement, paper_table
):
    """The target turns a little right after the departure."""
    left = {}
    for commit_cost in (0.0, 40.0):
        planner = PredictivePlanner(
            paper_aircraft, paper_requirement, paper_table, PredictiveSettings(0.0, commit_cost=commit_cost)
        )
        flight = begun(planner)
        departed_s = flight.aircraft.time_s
        flight.fly(turning_back((0.0, 4.5), departed_s, 0.5), 60.0)
        changed = [plan.departure_s - departed_s for _, _, plan in flight.plans[1:]]
        left[commit_cost] = changed or [60.0]
        if commit_cost:
            assert any("s old, and another would gain" in reason for reason in flight.reasons)
    assert left[0.0][0] < 10.0 <= left[40.0][0]


def test_a_plan_that_leads_out_of_the_band_is_left_at_once(paper_aircraft, paper_requirement, paper_table):
    planner = PredictivePlanner(paper_aircraft, paper_requirement, paper_table)
    flight = begun(planner)
    place = flight.aircraft.east_m + 105.0, flight.aircraft.north_m
    target = seen(flight.aircraft.time_s, place, (-3.0, 0.0))
    decision = planner.decide(flight.aircraft, target, flight.present, CALM, LATENCY_S)
    assert flight.aircraft.time_s - flight.present.departure_s < 10.0
    assert decision.plan is not None


def test_a_turn_that_would_bring_the_target_too_near_counts_however_cheap_staying_seems(
    paper_aircraft, paper_requirement, paper_table
):
    east_m, north_m = ALONGSIDE.position_at_course(0.53)
    aircraft = AircraftState(0.0, east_m, north_m, 0.53, 10.0, ALONGSIDE.curvature_per_m)
    target = seen(0.0, (-40.0, -14.7), (-3.7, 1.5))
    moved = []
    for threat_s in (PredictiveSettings().threat_s, 0.0):
        planner = PredictivePlanner(
            paper_aircraft, paper_requirement, paper_table, PredictiveSettings(threat_s=threat_s)
        )
        moved.append(planner.decide(aircraft, target, Plan(ALONGSIDE), CALM, LATENCY_S).plan is not None)
    assert moved == [True, False]

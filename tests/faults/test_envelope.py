"""What is flown is judged, not only what is planned: height, fences, home, the target's speed, limits and orders.

Each case is flown in the closed loop with the simulated vehicle of an autopilot, and begins after two minutes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.simulation.kinematic import LIVE_RATES, Body, KinematicVehicle, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.target import Payload, PayloadErrors, RandomTarget, TargetTruth
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.alarms import Alarms
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Announce, BankLimitReported, End, PlanStatus, UploadPlan
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from tests.faults import undisturbed

HOME = Home(47.4, 8.5, 400.0)
PLANE = LocalPlane(HOME.latitude_deg, HOME.longitude_deg)
BEGIN_S = 120.0
BOTH = pytest.mark.parametrize("autopilot", AUTOPILOTS, ids=lambda one: one.name)


class Walker:
    """A target on a course of its own: straight north at a speed that may change."""

    def __init__(self, speed_m_s: float, then_m_s: float) -> None:
        self._speeds_m_s = speed_m_s, then_m_s

    def at(self, time_s: float) -> TargetTruth:
        first, then = self._speeds_m_s
        north_m = first * min(time_s, BEGIN_S) + then * max(time_s - BEGIN_S, 0.0)
        return TargetTruth(0.0, north_m, 0.0, then if time_s > BEGIN_S else first, 0.0)


class Flight(ClosedLoop):
    """A flight with the default planner; ``range_m`` is the true range to the target, once a second."""

    def __init__(self, autopilot, configured=None, *, seed=1, body=None, target=None, wind=Wind()):  # noqa: B008
        config = Config.model_validate(configured or {})
        own, requirement = config.aircraft, config.requirement
        target_rng, noise_rng = (np.random.default_rng((seed, part)) for part in range(2))
        speed_m_s = requirement.target_speed_max_m_s
        self.target = target or RandomTarget(target_rng, 1200.0, speed_m_s, (20.0, 60.0))
        circle = Circle(-300.0, 0.0, own.radius_m, True)
        state = AircraftState(0.0, *circle.position_at_course(0.0), 0.0, own.airspeed_m_s, circle.curvature_per_m)
        start = Start(PLANE, HOME, circle, own.height_m, state)
        noise = Payload(PayloadErrors(), noise_rng)
        body = body or Body(own.airspeed_m_s, own.aircraft().bank_max_rad)
        super().__init__(KinematicVehicle(autopilot, body, wind, start, noise, self.target, LIVE_RATES))
        self.controller = prepared(config).controller(PLANE, (HOME.latitude_deg, HOME.longitude_deg))
        self.telemetry.plane = PLANE
        self.alarms, self.raised, self.outputs, self.range_m, self.claims = Alarms(), [], [], [], []
        self.listeners.append(self._note)
        self.start(
            lambda plane: mission_controller_of(config, self.controller, autopilot, plane, HOME), self.simulated.mode
        )

    @property
    def craft(self):
        return self.simulated.craft

    @property
    def time_s(self):
        return self.simulated.time_s

    def _note(self, _event, outputs):
        self.outputs += [(self.time_s, self.craft.height_m, one) for one in outputs]

    def fly(self, duration_s):
        for _ in range(round(duration_s)):
            self.run(1.0)
            now, truth = self.controller.snapshot(), self.target.at(self.time_s)
            self.raised += [(self.time_s, one) for one in self.alarms.update(now)[0]]
            self.range_m.append(math.hypot(self.craft.east_m - truth.east_m, self.craft.north_m - truth.north_m))
            self.claims.append((self.time_s, now.in_band))
        return self

    def undisturbed(self):
        """Fly for two minutes; nothing of the envelope is reported."""
        self.fly(BEGIN_S)
        assert self.raised == []
        return self

    def alarm_s(self, watched, text=""):
        """Return when the first alarm of an input was raised."""
        return min((at_s for at_s, one in self.raised if one.key == watched and text in one.text), default=math.inf)

    def found(self, kind, since_s=0.0):
        return [
            (at_s, height_m, one) for at_s, height_m, one in self.outputs if isinstance(one, kind) and at_s > since_s
        ]


def sinks(flight):
    flight.craft.build = replace(flight.craft.build, climb_max_m_s=-0.9)


@BOTH
def test_sinking_aircraft_is_reported_and_not_moved_below_the_floor(autopilot):
    flight = Flight(autopilot, {"fences": {"floor_m": 60.0}}).undisturbed()
    sinks(flight)
    left_s = math.inf
    for _ in range(100):
        flight.fly(1.0)
        if flight.craft.height_m < 85.0:
            left_s = min(left_s, flight.time_s)
    assert flight.craft.height_m < 20.0
    assert flight.alarm_s("height", "its plan is at 100 m") <= left_s + 5.0
    below = [one for _, height_m, one in flight.found(UploadPlan) if height_m < 60.0]
    assert {one.plan.circle for one in below} <= {flight.controller.present.circle}
    assert not any(claim for at_s, claim in flight.claims if at_s > left_s + 5.0)


def test_aircraft_below_the_floor_flies_home_if_configured():
    configured = {"fences": {"floor_m": 60.0}, "planner": {"at_breach": "return"}}
    flight = Flight(AUTOPILOTS[0], configured).undisturbed()
    sinks(flight)
    flight.fly(60.0)
    ((_, height_m, end),) = flight.found(End)
    assert end.action == "return"
    assert "below the floor" in end.reason
    assert height_m > 55.0


def test_breach_is_not_over_because_control_is_given_up():
    flight = Flight(AUTOPILOTS[0], {"fences": {"floor_m": 60.0}}).undisturbed()
    sinks(flight)
    while flight.craft.height_m > 50.0:
        flight.fly(1.0)
    flight.simulated.pilot_takes_over()
    flight.fly(15.0)
    assert not flight.controller.phase.in_control
    assert flight.craft.height_m < 55.0
    assert "below the floor" in flight.controller.breach
    assert flight.claims[-1][1] is not True


@BOTH
def test_items_stored_with_another_height_are_reported(autopilot):
    flight = Flight(autopilot, {"fences": {"floor_m": 60.0}}).undisturbed()
    mission = flight.simulated.simulated.mission
    put = mission.put
    mission.put = lambda index, item, *more: put(index, replace(item, altitude_m=item.altitude_m - 70.0), *more)
    left_s = math.inf
    for _ in range(90):
        flight.fly(1.0)
        if flight.craft.height_m < 85.0:
            left_s = min(left_s, flight.time_s)
    if autopilot.quirks.stores_items_one_by_one:  # read back: nothing of it is flown
        assert left_s == math.inf
        assert flight.alarm_s("orders", "reads back a height of 30 m, 100 m was sent") < BEGIN_S + 40.0
        return
    assert flight.alarm_s("height") <= left_s + 5.0
    below = [one for _, height_m, one in flight.found(UploadPlan) if height_m < 60.0]
    assert {one.plan.circle for one in below} <= {flight.controller.present.circle}


@BOTH
def test_aircraft_outside_the_fences_is_reported_and_moved_back_only(autopilot):
    corners = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    square = [list(PLANE.latitude_longitude_deg(900.0 * east, 900.0 * north)) for east, north in corners]
    flight = Flight(autopilot, {"fences": {"keep_in": [square]}}).undisturbed()
    flight.craft.build = replace(flight.craft.build, turn_efficiency=0.0)  # it flies on as it is
    out_s = math.inf

    def outside_m():
        return max(abs(flight.craft.east_m), abs(flight.craft.north_m)) - 900.0

    while flight.time_s < out_s + 20.0:
        flight.fly(1.0)
        if outside_m() > 0.0:
            out_s = min(out_s, flight.time_s)
    assert flight.alarm_s("fence") <= out_s + 5.0
    flight.craft.build = replace(flight.craft.build, turn_efficiency=1.0)
    farthest_m = outside_m()
    for _ in range(120):
        flight.fly(1.0)
        assert outside_m() <= farthest_m + 150.0  # the way round
    assert outside_m() < 0.0
    assert not any(claim for at_s, claim in flight.claims if out_s + 5.0 < at_s < out_s + 20.0)
    for _, _, sent in flight.found(UploadPlan, out_s + 5.0):
        circle = sent.plan.circle
        assert max(abs(circle.east_m), abs(circle.north_m)) + circle.radius_m <= 900.0


def set_home_lower(simulated, by_m):
    """Set home elsewhere as DO_SET_HOME does: the aircraft stays, what is stored counts from the new home."""
    simulated.home = replace(simulated.home, altitude_m=simulated.home.altitude_m - by_m)
    simulated.craft.height_m += by_m


@BOTH
def test_home_that_is_set_elsewhere_does_not_move_the_aircraft(autopilot):
    flight = Flight(autopilot).undisturbed()
    set_home_lower(flight.simulated.simulated, 55.0)
    start = flight.simulated._start
    flight.simulated._start = replace(start, home=replace(start.home, altitude_m=345.0))
    for _ in range(90):
        flight.fly(1.0)
        assert flight.craft.height_m == pytest.approx(155.0, abs=10.0)
    assert flight.alarm_s("home", "55 m lower") <= BEGIN_S + 5.0
    assert flight.controller.snapshot().height_m == pytest.approx(100.0, abs=2.0)


def test_layers_of_a_fleet_stay_where_home_is_set_elsewhere():
    """The upper one of two, in layers of 100 and 160 m, gets a home that is 55 m lower."""
    described = undisturbed.Flown(6, "fleet")
    crafts, advance = undisturbed._fleet(undisturbed._settings(6, np.random.default_rng(6)), described)
    for _ in undisturbed._until(crafts, advance, 300.0):
        if all(one.has_control and one.core.controller.snapshot().height_m > 95.0 for one in crafts):
            break
    for _ in undisturbed._until(crafts, advance, 30.0):
        pass
    crafts = sorted(crafts, key=lambda one: one.core.controller.snapshot().height_m)
    lower, upper = (one.simulation.vehicle for one in crafts)
    gaps_m = []
    set_home_lower(upper, 55.0)
    for tick, _ in enumerate(undisturbed._until(crafts, advance, 60.0)):
        if tick % 20 == 0:
            gaps_m.append(upper.craft.height_m - 55.0 - lower.craft.height_m)
    assert min(gaps_m) > 45.0
    assert min(gaps_m[-10:]) > 50.0
    (home,) = [one for one in crafts[1].core.controller.health.reports if one.input is Input.HOME]
    assert home.state is InputState.INCONSISTENT


@BOTH
@pytest.mark.parametrize(("speed_m_s", "within_s"), [(4.5, 40.0), (15.0, 15.0)])
def test_target_faster_than_its_limit_is_reported_and_unknown(autopilot, speed_m_s, within_s):
    flight = Flight(autopilot, target=Walker(2.0, speed_m_s)).undisturbed().fly(60.0)
    found_s = flight.alarm_s("speed", "its limit is 3 m/s")
    assert found_s <= BEGIN_S + within_s
    assert all(claim is None for at_s, claim in flight.claims if at_s > found_s)


@pytest.mark.parametrize(
    ("number", "bank_deg", "roll_deg_s"), [(0, 15.0, 60.0), (1, 20.0, 60.0), (1, 30.0, 5.0), (0, 22.0, 5.0)]
)
def test_bank_and_roll_rate_that_are_not_reached_are_planned_with(number, bank_deg, roll_deg_s):
    flight = Flight(AUTOPILOTS[number], body=Body(15.0, math.radians(bank_deg), math.radians(roll_deg_s))).fly(600.0)
    assert min(flight.range_m) >= 80.0
    assert flight.alarm_s("aircraft") < math.inf
    learned = flight.controller.settings.aircraft
    assert learned.bank_max_rad <= math.radians(bank_deg + 3.0) or learned.roll_rate_max_rad_s <= math.radians(6.0)


@BOTH
def test_bank_limit_that_another_station_lowers_widens_the_circle(autopilot):
    configured = {"aircraft": {"airspeed_m_s": 22.0, "radius_m": 80.0}}
    flight = Flight(autopilot, configured).undisturbed()
    flight.simulated.simulated.parameters.set(flight.simulated.simulated.roll_limit_parameter, 25.0)
    flight.put(BankLimitReported(flight.telemetry.now_s, math.radians(25.0)))
    flight.fly(60.0)
    least_m = 22.0**2 / (9.80665 * math.tan(math.radians(25.0)))
    assert flight.controller.present.circle.radius_m > least_m
    assert flight.alarm_s("aircraft", "by its parameters it banks 25 degrees") <= BEGIN_S + 5.0
    flight.fly(240.0)
    ranges_m = np.array(flight.range_m[round(BEGIN_S) + 60 :])
    assert np.mean((ranges_m >= 100.0) & (ranges_m <= 500.0)) >= 0.99
    flight.put(BankLimitReported(flight.telemetry.now_s, math.radians(50.0)))
    flight.fly(2.0)
    assert flight.controller.settings.aircraft.radius_m == 80.0


def test_band_without_room_for_the_circle_is_reported_and_the_target_kept_away_from():
    configured = {"aircraft": {"airspeed_m_s": 22.0, "radius_m": 80.0}, "requirement": {"range_max_m": 300.0}}
    flight = Flight(AUTOPILOTS[0], configured)
    flight.fly(BEGIN_S)
    flight.simulated.simulated.parameters.set("ROLL_LIMIT_DEG", 20.0)
    flight.put(BankLimitReported(flight.telemetry.now_s, math.radians(20.0)))
    flight.fly(300.0)
    assert flight.alarm_s("aircraft", "no circle that it can fly fits") <= BEGIN_S + 5.0
    assert min(flight.range_m[round(BEGIN_S) :]) >= 80.0


@BOTH
def test_orders_that_do_not_get_through_raise_an_alarm(autopilot):
    flight = Flight(autopilot, target=Walker(2.0, 2.0)).undisturbed()
    flight.simulated.receive = lambda _frame: None
    flight.fly(240.0)
    first_s = min(at_s for at_s, _, one in flight.found(PlanStatus, BEGIN_S) if one.stage == "failed")
    assert flight.alarm_s("orders", "did not get through (upload timeout)") <= first_s + 30.0


def test_search_is_not_decided_again_each_second():
    flight = Flight(AUTOPILOTS[0], target=Walker(1.0, 1.0)).undisturbed()
    flight.simulated._payload = None
    flight.fly(150.0)
    moves = "moving away", "searching"
    moved_s = [at_s for at_s, _, one in flight.found(Announce, BEGIN_S) if one.text.startswith(moves)]
    assert len(moved_s) >= 1
    assert all(later - sooner >= 10.0 for sooner, later in pairwise(moved_s))

"""The closed loop: the whole core against a kinematic vehicle and against the one of sitl, without sockets."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.assembly import mission_controller_of, tracker_of
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.simulation.kinematic import LIVE_RATES, Body, KinematicVehicle, Rates, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.target import Payload, PayloadErrors, RandomTarget
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, PlanStatus, Yield
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.paper.planner import PaperPlanner
from sidelong.sitl.settings import Flavour, LinkFaults, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation
from tests.faulty_loop import FaultyLoop, Link, Silence
from tests.faulty_payload import FaultyPayload, PayloadFaults
from tests.sitl_vehicle import SitlVehicle

HOME = Home(47.4, 8.5, 400.0)
PLANE = LocalPlane(HOME.latitude_deg, HOME.longitude_deg)
CIRCLE = Circle(-300.0, 0.0, 50.0, True)


def vehicle_of(autopilot, *, seed=1, rates=LIVE_RATES, wind=Wind()):  # noqa: B008  # frozen
    target_rng, noise_rng = (np.random.default_rng((seed, part)) for part in range(2))
    state = AircraftState(0.0, *CIRCLE.position_at_course(0.0), 0.0, 15.0, CIRCLE.curvature_per_m)
    target = RandomTarget(target_rng, 600.0, 3.0, (20.0, 60.0))
    start = Start(PLANE, HOME, CIRCLE, 100.0, state)
    return KinematicVehicle(autopilot, Body(15.0), wind, start, Payload(PayloadErrors(), noise_rng), target, rates)


class Flight:
    """A kinematic vehicle flown by the paper's planner, taken over in flight."""

    def __init__(self, autopilot, guidance="mission", **links):
        config = Config.model_validate({"planner": {"name": "paper", "guidance": guidance}})
        settings = config.requirement.requirement(), config.aircraft.aircraft()
        self.controller = StandoffController(
            StandoffSettings(*settings, give_up_after_s=1e9), tracker_of(config), PaperPlanner
        )
        self.vehicle = vehicle_of(autopilot)
        self.loop = FaultyLoop(self.vehicle, **links)
        self.loop.telemetry.plane = PLANE
        self.outputs = []
        self.loop.listeners.append(lambda _event, outputs: self.outputs.extend(outputs))
        self.loop.start(
            lambda plane: mission_controller_of(config, self.controller, autopilot, plane, HOME), self.vehicle.mode
        )

    def found(self, kind):
        return [output for output in self.outputs if isinstance(output, kind)]

    def departed(self):
        return [one.number for one in self.found(PlanStatus) if one.stage == "departed"]


@pytest.mark.parametrize(
    ("autopilot", "guidance"),
    [(one, "mission") for one in AUTOPILOTS] + [(one, "command") for one in AUTOPILOTS if not one.circles_refused],
    ids=lambda one: getattr(one, "name", one),
)
def test_plans_are_uploaded_activated_and_flown(autopilot, guidance):
    flight = Flight(autopilot, guidance)
    flight.loop.run(240.0)
    (acquired,) = flight.found(ControlAcquired)
    assert (acquired.circle.east_m, acquired.circle.north_m) == pytest.approx((-300.0, 0.0), abs=0.1)
    assert flight.departed()
    assert not flight.found(Yield)
    planned, flown = flight.controller.changes.present.circle, flight.vehicle.state
    away_m = math.hypot(flown.east_m - planned.east_m, flown.north_m - planned.north_m)
    assert away_m == pytest.approx(planned.radius_m, rel=0.25)


@pytest.mark.parametrize("autopilot", AUTOPILOTS, ids=lambda one: one.name)
def test_a_bad_link_delays_plans_and_ends_no_flight(autopilot):
    faults, rngs = LinkFaults(loss=0.05, duplicate=0.05, delay_s=0.2, jitter_s=0.1), np.random.default_rng(3).spawn(2)
    flight = Flight(autopilot, down=Link(faults, rngs[0], (Silence(60.0, 62.0),)), up=Link(faults, rngs[1]))
    flight.loop.run(240.0)
    assert flight.departed()
    assert not flight.found(Yield)


def test_the_same_seeds_fly_the_same_to_the_last_bit():
    states = []
    for _ in range(2):
        link = Link(LinkFaults(loss=0.2, delay_s=0.1), np.random.default_rng(5))
        flight = Flight(AUTOPILOTS[0], down=link)
        flight.loop.run(120.0)
        states.append((flight.vehicle.state, flight.outputs))
    assert repr(states[0]) == repr(states[1])  # NaN is not equal to itself


def test_a_pilot_who_changes_the_mode_is_yielded_to():
    flight = Flight(AUTOPILOTS[0])
    flight.loop.run(30.0)
    flight.vehicle.pilot_takes_over()
    flight.loop.run(5.0)
    (reason,) = [one.reason for one in flight.found(Yield)]
    assert "flight mode" in reason


def test_rates_that_do_not_fit_the_tick_are_refused():
    with pytest.raises(ValueError, match="do not divide 5 Hz"):
        vehicle_of(AUTOPILOTS[0], rates=Rates(position_hz=3))


def test_silences_and_changes_of_packets_are_kept_to():
    link = Link(LinkFaults(), np.random.default_rng(1), (Silence(1.0, 2.0),))
    for time_s in (0.5, 1.5, 2.5):
        link.put(time_s, time_s)
    assert link.take(3.0) == [0.5, 2.5]
    doubled = Link(
        LinkFaults(), np.random.default_rng(1), change=lambda packet, _now: [(0.0, packet), (2.0, -packet)]
    )
    doubled.put(1, 0.0)
    assert doubled.take(1.0) == [1]
    assert doubled.take(2.0) == [-1]


def test_payload_errors_have_their_sizes():
    errors = PayloadFaults(outliers=0.1, dropouts_per_s=0.05, dropout_s=4.0)
    payload, ranges, count = FaultyPayload(errors, np.random.default_rng(2)), [], 5000
    for k in range(count):
        ranges += [
            one.fields["current_distance"] * 0.01
            for one in payload.measure(0.2 * k, 200 * k, 300.0, 0.0, -100.0)
            if one.name == "DISTANCE_SENSOR"
        ]
    off_m = np.array(ranges) - math.hypot(300.0, 100.0)
    assert np.mean(np.abs(off_m) > 5.0) == pytest.approx(0.1 * 0.94, abs=0.03)
    assert np.std(off_m[np.abs(off_m) < 3.0]) == pytest.approx(0.8, rel=0.1)
    assert len(ranges) / count == pytest.approx(20.0 / 24.0, abs=0.08)  # 20 s between dropouts of 4 s


@pytest.mark.parametrize("camera", [{}, {"has_laser": False, "view_deg": 30.0}], ids=["laser", "camera"])
def test_a_gimbal_waits_at_its_stop_for_a_target_beyond_its_pan_limits(camera):
    errors = PayloadFaults(angle_sigma_rad=0.0, yaw_bias_rad=0.0, off_axis=0.0, pan_limit_rad=2.0, **camera)
    payload = FaultyPayload(errors, np.random.default_rng(2))
    for pan_rad, yaw_rad in ((1.9, 1.9), (-1.9, -1.9), (2.1, 2.0), (-2.1, -2.0)):
        heading_rad = 0.8
        at = 300.0 * math.sin(heading_rad + pan_rad), 300.0 * math.cos(heading_rad + pan_rad), -100.0
        gimbal, *others = payload.measure(0.0, 0, *at, heading_rad=heading_rad)
        wanted = from_roll_pitch_yaw(0.0, math.atan2(-100.0, 300.0), heading_rad + yaw_rad)
        assert abs(np.dot(gimbal.fields["q"], wanted)) == pytest.approx(1.0, abs=1e-6)
        assert bool(others) == (abs(pan_rad) < 2.0)


@pytest.mark.parametrize("flavour", Flavour)
def test_the_vehicle_of_sitl_flies_in_the_same_loop(flavour):
    """From the ground, every message as a frame."""
    settings = Settings(flavour, targets=(TargetSettings(speed_max_m_s=0.5),))
    vehicle = SitlVehicle(Simulation(settings))
    config = Config.model_validate({"planner": {"name": "paper"}})
    autopilot = next(one for one in AUTOPILOTS if one.name.lower() == flavour)
    controller = StandoffController(
        StandoffSettings(config.requirement.requirement(), config.aircraft.aircraft()),
        tracker_of(config),
        PaperPlanner,
    )
    home = vehicle.simulation.vehicle.home
    loop, outputs = ClosedLoop(vehicle), []
    loop.listeners.append(lambda _event, found: outputs.extend(found))
    where = Home(home.latitude_deg, home.longitude_deg, home.altitude_m)
    loop.start(lambda plane: mission_controller_of(config, controller, autopilot, plane, where))
    assert loop.run(240.0, lambda: any(isinstance(one, ControlAcquired) for one in outputs)), outputs[-3:]

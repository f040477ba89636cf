"""Alarms and the page's band and side against the truth, over closed-loop flights with dropouts of the laser.

ALARM_FLIGHTS=40 ALARM_FLIGHT_S=600 python -m pytest tests/bench/test_alarms.py -s
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.flight.flight import AlarmWatch
from sidelong.app.simulation.kinematic import LIVE_RATES, Body, KinematicVehicle, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.target import RandomTarget, TargetTruth
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane, wrap_rad
from sidelong.mission.control.present import VehicleStatus
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import AlarmReported
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.viewpoint.watch_course import TargetCourse
from tests.bench.size import size
from tests.faulty_payload import FaultyPayload, PayloadFaults

FLIGHTS = size(4, 1, "ALARM_FLIGHTS")
FLIGHT_S = float(size(600, 150, "ALARM_FLIGHT_S"))
STEP_S, UNSEEN_S = 0.5, 9.0  # s without a range: an alarm at 10 s, less the time to the next look
HOME = Home(47.4, 8.5, 400.0)
PLANE = LocalPlane(HOME.latitude_deg, HOME.longitude_deg)
CIRCLE = Circle(-300.0, 0.0, 50.0, True)
ERRORS = PayloadFaults(outliers=0.02, dropouts_per_s=0.03, dropout_s=5.0)
STATUS = VehicleStatus(80, 12.0, "3D, 11 satellites", True, 99, 0.05)


class _Recorded(FaultyPayload):
    """Records when the laser last sent a range that was not an outlier by more than the filter accepts."""

    ranged_s = -math.inf

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, **how):
        sent = super().measure(time_s, boot_ms, east_m, north_m, up_m, **how)
        true_m = math.hypot(east_m, north_m, up_m)
        ranges_m = [0.01 * one.fields["current_distance"] for one in sent if one.name == "DISTANCE_SENSOR"]
        if any(abs(range_m - true_m) < 5.0 * ERRORS.range_sigma_m for range_m in ranges_m):
            self.ranged_s = time_s
        return sent


@dataclass
class Flown:
    """What one flight came to, by the truth: seconds, and the longest stretch on end."""

    known_s: float = 0.0
    wrong_s: dict[str, float] = field(default_factory=lambda: {"band": 0.0, "side": 0.0})
    longest_s: dict[str, float] = field(default_factory=lambda: {"band": 0.0, "side": 0.0})
    alarms: list[tuple[str, bool]] = field(default_factory=list)  # key, and whether the truth supports it


def exactly(time_s: float, true: TargetTruth) -> TargetEstimate:
    """Return the truth as an estimate."""
    state = true.east_m, true.north_m, true.velocity_east_m_s, true.velocity_north_m_s
    return TargetEstimate(time_s, *state, np.zeros((4, 4)), TrackQuality.GOOD, time_s)


def flown(seed: int) -> Flown:
    """Fly one flight and compare what the page shows with the truth."""
    config = Config()
    autopilot = AUTOPILOTS[seed % len(AUTOPILOTS)]
    target_rng, noise_rng = (np.random.default_rng((seed, part)) for part in range(2))
    state = AircraftState(0.0, *CIRCLE.position_at_course(0.0), 0.0, 15.0, CIRCLE.curvature_per_m)
    target = RandomTarget(target_rng, FLIGHT_S + 100.0, 3.0, (20.0, 120.0))
    start = Start(PLANE, HOME, CIRCLE, 100.0, state)
    payload = _Recorded(ERRORS, noise_rng)
    vehicle = KinematicVehicle(autopilot, Body(15.0), Wind(), start, payload, target, LIVE_RATES)
    controller, loop, result = prepared(config).controller(), ClosedLoop(vehicle), Flown()
    loop.telemetry.plane = PLANE
    loop.start(lambda plane: mission_controller_of(config, controller, autopilot, plane, HOME), vehicle.mode)
    events: list[object] = []
    watch = AlarmWatch(config, (0.0, 0.0), lambda: STATUS, events.append, lambda _text: None, lambda: vehicle.time_s)
    course = TargetCourse()
    wanted, since_s = controller.settings.requirement, {"band": 0.0, "side": 0.0}
    for tick in range(round(FLIGHT_S / STEP_S)):
        unseen_s = vehicle.time_s - payload.ranged_s + STEP_S  # a range may come in the step that raises the alarm
        loop.run(STEP_S)
        snapshot = controller.snapshot()
        shown, true, own = watch.completed(snapshot), target.at(vehicle.time_s), vehicle.state
        course.update(exactly(vehicle.time_s, true), wanted.course_horizon_s)
        east_m, north_m = own.east_m - true.east_m, own.north_m - true.north_m
        in_band = wanted.range_min_m <= math.hypot(east_m, north_m) <= wanted.range_max_m
        middle_rad = None if course.made_good_rad is None else course.made_good_rad + wanted.side.normal_turn_rad
        on_side = (
            None if middle_rad is None else abs(wrap_rad(math.atan2(east_m, north_m) - middle_rad)) <= math.pi / 2
        )
        supports = {
            "band": in_band is False,
            "side": on_side is False,
            "target": unseen_s >= UNSEEN_S,
        }
        result.alarms += [
            (one.key, supports.get(one.key, False))
            for one in events
            if isinstance(one, AlarmReported) and one.stage == "raised"
        ]
        events.clear()
        if tick * STEP_S < 60.0:  # the target's course is being found
            continue
        result.known_s += STEP_S
        for name, announced, truth in (("band", shown.in_band, in_band), ("side", shown.on_side, on_side)):
            wrong = announced is not None and truth is not None and announced != truth
            since_s[name] = since_s[name] + STEP_S if wrong else 0.0
            result.wrong_s[name] += STEP_S * wrong
            result.longest_s[name] = max(result.longest_s[name], since_s[name])
    return result


def test_what_the_page_shows_is_true_and_no_alarm_is_false():
    flights = [flown(seed) for seed in range(FLIGHTS)]
    known_s = sum(one.known_s for one in flights)
    misses = []
    for name in ("band", "side"):
        wrong = sum(one.wrong_s[name] for one in flights) / known_s
        longest_s = max(one.longest_s[name] for one in flights)
        print(f"{name}: wrong for {100.0 * wrong:.2f} % of {known_s:.0f} s, longest {longest_s:.1f} s")
        late = [seed for seed, one in enumerate(flights) if one.longest_s[name] > 5.0]
        misses += [f"{name}: {100.0 * wrong:.2f} %, over 5 s in flights {late}"] if wrong > 0.01 or late else []
    raised = Counter(key for one in flights for key, _ in one.alarms)
    false = Counter(key for one in flights for key, supported in one.alarms if not supported)
    print(f"{len(flights)} flights, {dict(raised)} alarms raised, {dict(false)} without support by the truth")
    assert (misses, dict(false)) == ([], {})

"""Inputs that are silent, stuck or contradict each other are reported, and the flight does not follow them."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
)
from sidelong.estimators.tracking.payload_fit import PayloadFit
from sidelong.estimators.tracking.sources import SourceSelector, range_rank, sight_rank
from sidelong.mission.core.events import ClockTick, LinkReported, ModeReported
from sidelong.mission.core.fleet import FleetAdvice, Role
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.core.requirement import Side
from sidelong.mission.health.health import Health
from sidelong.sitl.arduplane import ArduPlaneNavigator
from tests.faults.flight import ERRORS, FaultedFlight, Scenario
from tests.faults.flight_faults import (
    GIMBAL,
    LASER,
    Fault,
    flagged,
    later,
    lengthening,
    moved,
    only,
    other_device,
    pitching,
    repeated,
    rising,
    scaled,
    silent,
    turned,
    turning,
    with_fields,
    wrong_at,
)
from tests.faulty_payload import FaultyPayload

BEGIN_S, DURATION_S = 60.0, 150.0


def selectors(laser=None):
    """Return which laser and which gimbal are in use."""
    lasers, gimbals = SourceSelector(range_rank), SourceSelector(sight_rank)
    lasers.chosen = laser
    return lasers, gimbals


def with_frozen_yaw(message, _since_s, _rng):
    """Let the gimbal look east, at the depression at which it looks."""
    w, x, y, z = message.fields["q"]
    half_rad = math.asin(2.0 * (w * y - z * x)) / 2.0
    east, cos, sin = math.sqrt(0.5), math.cos(half_rad), math.sin(half_rad)
    return with_fields(message, q=[east * cos, -east * sin, east * sin, east * cos])


PAYLOAD_FAULTS = {
    "stuck laser": (repeated(LASER, "current_distance"), Input.LASER, "repeats the same range"),
    "stuck laser with 1 cm of noise": (repeated(LASER, "current_distance", 1), Input.LASER, "repeats the same range"),
    "range in a tenth": (scaled(0.1), Input.LASER, "a tenth of the distance"),
    "range in feet": (scaled(0.3048), Input.LASER, "feet"),
    "flags of the vehicle frame": (flagged(44), Input.GIMBAL, 'sensors.gimbal_frame = "earth"'),
    "flags of the body frame": (flagged(32), Input.GIMBAL, 'sensors.gimbal_frame = "earth"'),
    "frozen gimbal": (repeated(GIMBAL, "q"), Input.GIMBAL, "frozen"),
    "yaw of the gimbal frozen": (only(GIMBAL, with_frozen_yaw), Input.GIMBAL, "its yaw is frozen"),
}


@pytest.mark.parametrize("name", PAYLOAD_FAULTS)
def test_contradictory_payload_is_reported_and_not_followed(name):
    change, input_, words = PAYLOAD_FAULTS[name]
    flown = FaultedFlight(Scenario(1, "px4", DURATION_S), [Fault(name, BEGIN_S, math.inf, change)]).fly()
    found = [
        (time_s, one)
        for time_s, one in flown.health
        if one.input is input_ and one.state is InputState.INCONSISTENT and words in one.text
    ]
    assert BEGIN_S < found[0][0] <= BEGIN_S + 15.0
    assert len(found) == 1
    assert min(flown.range_m) > 80.0
    assert flown.wrongly_in_band_s <= 0.02 * DURATION_S
    # Afterwards the flight does not know how well it watches.
    assert flown.unknown_s >= DURATION_S - found[0][0] - 1.0


def test_payload_is_checked_while_the_attitude_is_silent():
    """Angles relative to north need none; the sightings go on."""
    silence = Fault("attitude", BEGIN_S, math.inf, silent(("ATTITUDE",)))
    fault = Fault("feet", BEGIN_S + 10.0, math.inf, scaled(0.3048))
    flown = FaultedFlight(Scenario(1, "px4", DURATION_S), [silence, fault]).fly()
    found_s = [time_s for time_s, one in flown.health if one.input is Input.LASER and "feet" in one.text]
    assert found_s[0] <= BEGIN_S + 25.0
    assert flown.wrongly_in_band_s <= 0.02 * DURATION_S


def test_payload_is_used_in_each_of_the_moments_in_which_a_link_works():
    """1.5 s of each 5 s; half a second of that confirms the vehicle's clock."""

    def now_and_then(message, since_s, _rng):
        return iter([(0.0, message)] if since_s % 5.0 > 3.5 else [])

    flown = FaultedFlight(Scenario(5, "px4", DURATION_S), [Fault("link", BEGIN_S, math.inf, now_and_then)]).fly()
    unseen_s = [one.unseen_s for one in flown.decided if one.time_s > BEGIN_S]
    assert unseen_s
    assert max(unseen_s) < 6.0


@pytest.mark.parametrize("seed", [1, 5])
def test_unit_that_changes_while_the_link_is_silent_is_found(seed):
    silence = Fault("link", BEGIN_S, BEGIN_S + 25.0, lambda _message, _since_s, _rng: iter(()))
    fault = Fault("feet", BEGIN_S + 10.0, math.inf, scaled(0.3048))
    flown = FaultedFlight(Scenario(seed, "px4", DURATION_S), [silence, fault]).fly()
    found_s = [time_s for time_s, one in flown.health if one.input is Input.LASER and "feet" in one.text]
    assert found_s[0] <= BEGIN_S + 25.0 + 15.0
    assert flown.wrongly_in_band_s <= 0.02 * DURATION_S


@pytest.mark.parametrize("name", PAYLOAD_FAULTS)
def test_payload_that_is_corrected_is_used_again(name):
    change, input_, _ = PAYLOAD_FAULTS[name]
    fault = Fault(name, BEGIN_S, BEGIN_S + 40.0, change)
    flown = FaultedFlight(Scenario(1, "px4", DURATION_S), [fault]).fly()
    states = [(at_s, one.state) for at_s, one in flown.health if one.input is input_]
    assert [state for _, state in states] == [InputState.INCONSISTENT, InputState.OK]
    at_once = name.startswith("flags")
    assert BEGIN_S + 40.0 <= states[1][0] <= BEGIN_S + (43.0 if at_once else 75.0)
    assert flown.yielded is None
    assert any(decided.time_s > BEGIN_S + 75.0 for decided in flown.decided)


@pytest.mark.parametrize(("name", "seed"), [("stuck laser", 3), ("range in a tenth", 3), ("range in feet", 5)])
def test_aircraft_keeps_away_from_a_target_that_walks_towards_it_unseen(name, seed):
    change = PAYLOAD_FAULTS[name][0]
    begin_s = 60.0 + 7.0 * (seed % 5)
    flown = FaultedFlight(Scenario(seed, "arduplane", 240.0), [Fault(name, begin_s, math.inf, change)]).fly()
    assert min(flown.range_m) > 80.0
    assert any(text.startswith("moving away: the target is not seen") for _, text in flown.announced)


def test_laser_that_meets_the_background_again_and_again_is_reported():
    """50 m too far, half of the time, for 5 s each."""

    def beyond(message, since_s, _rng):
        far_cm = 5000 if int(since_s / 5.0) % 2 else 0
        return with_fields(message, current_distance=message.fields["current_distance"] + far_cm)

    fault = Fault("background", BEGIN_S, math.inf, only(LASER, beyond))
    flown = FaultedFlight(Scenario(3, "arduplane", 300.0), [fault]).fly()
    assert any(
        one.input is Input.SIGHTINGS and one.state is InputState.INCONSISTENT and "jumped 3 times" in one.text
        for _, one in flown.health
    )


def test_single_wrong_ranges_of_a_slow_laser_are_no_jumps_of_the_target():
    """At 1 Hz, two lines of sight are paired with each of them. Two wrong ones in a row are a jump."""
    count = 0

    class WithoutOutliers(FaultedFlight):
        def payload(self, rng):
            return FaultyPayload(replace(ERRORS, outliers=0.0), rng)

    def slow(message, _since_s, _rng):
        nonlocal count
        count += 1
        far_cm = 6000 if count % 160 == 0 else 0
        far = with_fields(message, current_distance=message.fields["current_distance"] + far_cm)
        return far if count % 10 == 0 else None

    fault = Fault("slow", 0.0, math.inf, only(LASER, slow))
    flown = WithoutOutliers(Scenario(3, "arduplane", 200.0), [fault]).fly()
    assert not flown.health
    assert flown.unknown_s == 0.0


def test_aircraft_that_does_not_follow_its_plans_is_reported(monkeypatch):
    flight, go_to = FaultedFlight(Scenario(3, "arduplane", 400.0)), ArduPlaneNavigator.go_to

    def begun(self, goal, then, clockwise):
        if flight.simulated.time_s < BEGIN_S:  # later, it acknowledges everything, and flies on as it does
            go_to(self, goal, then, clockwise)

    monkeypatch.setattr(ArduPlaneNavigator, "go_to", begun)
    flown = flight.fly()
    assert any("be ready to take over" in text for _, text in flown.announced)


@pytest.mark.parametrize("name", ["range in a tenth", "flags of the vehicle frame", "flags of the body frame"])
def test_no_plan_is_made_by_a_target_that_jumped(name):
    change = PAYLOAD_FAULTS[name][0]
    flown = FaultedFlight(Scenario(110, "px4", 100.0), [Fault(name, BEGIN_S, math.inf, change)]).fly()
    found_s = next(at_s for at_s, one in flown.health if one.state is InputState.INCONSISTENT)
    assert found_s <= BEGIN_S + 8.0
    assert not any(one.moved for one in flown.decided if BEGIN_S + 1.0 < one.time_s < found_s)


def test_stuck_laser_is_found_while_the_aircraft_flies_straight_past_the_target():
    payload, laser, gimbal = PayloadFit(), Source("DISTANCE_SENSOR", 154), Source("GIMBAL", 154)
    found_s = []
    for k in range(150):
        time_s = 0.1 * k
        north_m = 15.0 * time_s - 112.0
        half_rad = 0.5 * math.atan2(300.0, -north_m)
        payload.attitude(AttitudeReading(time_s, 0.0, 0.0, 0.0))
        payload.position(PositionReading(time_s, 0.0, north_m, 0.0, 0.0, 15.0, 0.0))
        payload.range(RangeReading(time_s, 320.0 + 0.02 * (k % 2), laser))
        payload.gimbal(GimbalReading(time_s, (math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)), "earth", gimbal))
        found_s += [time_s] if payload.laser_fault else []
    assert found_s
    assert found_s[0] <= 9.0


def test_single_readings_with_other_flags_are_outliers():
    payload, laser, gimbal = PayloadFit(), Source("DISTANCE_SENSOR", 154), Source("GIMBAL", 154)
    odd = 0
    for k in range(200):
        time_s = 0.1 * k
        north_m = 15.0 * time_s - 150.0
        half_rad = 0.5 * math.atan2(300.0, -north_m)
        frame = "vehicle" if k % 60 >= 56 else "earth"  # long enough to be sampled once
        payload.attitude(AttitudeReading(time_s, 0.0, 0.0, 1.0))
        payload.position(PositionReading(time_s, 0.0, north_m, 0.0, 0.0, 15.0, 0.0))
        payload.range(RangeReading(time_s, math.hypot(300.0, north_m), laser))
        payload.gimbal(GimbalReading(time_s, (math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)), frame, gimbal))
        odd += frame == "vehicle"
        assert not payload.is_suspect(time_s)
    assert odd == 12


def test_reading_before_the_clock_is_known_is_not_silent_indefinitely():
    health = Health(PayloadFit())
    health.received(RangeReading(1.0, 200.0, Source("DISTANCE_SENSOR", 154)), -math.inf)
    assert health.changes(30.0, *selectors()) == ()


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("GIMBAL_DEVICE_ATTITUDE_STATUS", "no orientation from the gimbal"),
        (IMAGE_TRACKER, "no target in the camera"),
    ],
)
def test_camera_that_has_lost_its_object_is_no_silent_gimbal(message, words):
    health, (lasers, gimbals), source = Health(PayloadFit()), selectors(), Source(message, 100)
    gimbals.chosen, changes = source, []
    for second in range(30):
        if second < 10:
            health.received(GimbalReading(float(second), (1.0, 0.0, 0.0, 0.0), "earth", source), float(second))
        health.received(ClockTick(float(second), float(second)), float(second))
        changes += health.changes(float(second), lasers, gimbals)
    assert [one.text[: len(words)] for one in changes if one.state is InputState.STALE] == [words]


def test_gimbal_that_takes_the_place_of_a_silent_one_has_to_agree_with_the_track():
    change = other_device(GIMBAL, q=[1.0, 0.0, 0.0, 0.0])
    flown = FaultedFlight(Scenario(1, "px4", 100.0), [Fault("other", BEGIN_S, math.inf, change)]).fly()
    texts = [one.text for _, one in flown.health]
    assert any("component 171" in text and "contradicts the track" in text for text in texts)
    assert not any("in use is now" in text for text in texts)
    # The second one does not make the silent one fresh.
    (gone_s, gone) = next((at_s, one) for at_s, one in flown.health if one.input is Input.GIMBAL)
    assert gone.text.startswith("no orientation from the gimbal")
    assert gone_s <= BEGIN_S + 7.0
    assert flown.unknown_s >= 100.0 - BEGIN_S - 8.0


def test_second_gimbal_that_agrees_is_used_and_the_change_reported():
    change = other_device(GIMBAL)
    flown = FaultedFlight(Scenario(1, "px4", 100.0), [Fault("other", BEGIN_S, math.inf, change)]).fly()
    gone, switched = (one for _, one in flown.health)
    assert (gone.state, switched.state) == (InputState.STALE, InputState.SWITCHED)
    assert "component 171" in switched.text
    assert "component 154" in switched.text


@pytest.mark.parametrize(
    ("names", "input_", "within_s"),
    [
        (("GLOBAL_POSITION_INT",), Input.POSITION, 5.0),
        (("GLOBAL_POSITION_INT", "ATTITUDE"), Input.POSITION, 5.0),
        (("HEARTBEAT",), Input.HEARTBEAT, 7.0),
    ],
)
def test_silent_input_is_reported_once_and_its_return_as_well(names, input_, within_s):
    fault = Fault("silent", BEGIN_S, BEGIN_S + 30.0, silent(names))
    flown = FaultedFlight(Scenario(1, "px4", 140.0), [fault]).fly()
    (gone_s, gone), (back_s, back) = [(at_s, one) for at_s, one in flown.health if one.input is input_]
    assert gone.state is InputState.STALE
    assert gone_s <= BEGIN_S + within_s
    assert back.state is InputState.OK
    assert back_s - gone_s - 0.5 <= back.lasted_s <= 31.0
    assert back.text.endswith(f"again, after {back.lasted_s:.0f} s")
    assert BEGIN_S + 30.0 <= back_s <= BEGIN_S + 32.0
    assert not any("clock is" in text for at_s, text in flown.announced if at_s > BEGIN_S)  # no one else is blamed
    assert flown.yielded is None
    assert any(decided.time_s > BEGIN_S + 35.0 for decided in flown.decided)


def test_nothing_new_is_commanded_without_heartbeat():
    fault = Fault("silent", BEGIN_S, math.inf, silent(("HEARTBEAT",)))
    flown = FaultedFlight(Scenario(1, "px4", DURATION_S), [fault]).fly()
    assert not any(decided.time_s > BEGIN_S + 8.0 for decided in flown.decided)


@pytest.mark.parametrize("seed", range(4))
def test_undisturbed_flight_raises_no_alarm(seed):
    flight = FaultedFlight(Scenario(seed, ("px4", "arduplane")[seed % 2], 200.0))
    flown = flight.fly()
    assert flown.health == []
    assert min(flight.controller.tracker.payload.used_s) >= 0.0  # no payload measures after its stamp
    assert flown.wrongly_in_band_s == 0.0


def test_age_counts_by_this_computer_while_the_vehicle_clock_stands_still():
    health = Health(PayloadFit())
    health.received(PositionReading(10.0, 0.0, 0.0, 100.0, 15.0, 0.0, 0.0), 10.0)
    states = []
    for second in range(8):
        assert health.received(ClockTick(10.0, float(second)), 10.0)
        states += [one.state for one in health.changes(10.0, *selectors())]
    assert states == [InputState.STALE]
    assert not health.is_usable(Input.POSITION)
    assert health.silent_s >= 5.0


def test_lost_link_is_not_reported_as_silent_inputs():
    health = Health(PayloadFit())
    health.received(ModeReported(10.0, "AUTO", armed=True), 10.0)
    health.link_changed(LinkReported(10.0, connected=False), 10.0)
    for second in range(20):
        health.received(ClockTick(10.0, float(second)), 10.0)
        assert health.changes(10.0, *selectors()) == ()
    health.link_changed(LinkReported(30.0, connected=True), 30.0)
    assert health.changes(30.0, *selectors()) == ()


def test_lost_link_is_a_state_and_ends_with_the_link():
    health = Health(PayloadFit())
    lost = health.link_changed(LinkReported(10.0, connected=False), 10.0)
    assert lost.text == "link lost: the aircraft goes on circling"
    assert [(one.input, one.state) for one in health.reports] == [(Input.LINK, InputState.STALE)]
    back = health.link_changed(LinkReported(30.0, connected=True), 30.0)
    assert (back.text, back.lasted_s) == ("the link is back, after 20 s", 20.0)
    assert [(one.input, one.state) for one in health.reports] == [(Input.LINK, InputState.OK)]


def test_fleet_that_reports_no_more_is_reported_once():
    health, texts = Health(PayloadFit()), []
    health.received(FleetAdvice(10.0, "boat", Role.WANTED, Side.LEFT, None, 100.0, ()), 10.0)
    for second in range(10, 30):
        health.received(ClockTick(float(second), float(second)), float(second))
        texts += [one.text for one in health.changes(float(second), *selectors())]
    (text,) = texts
    assert text.startswith("no report of the fleet for 6 s")


def test_clock_of_the_aircraft_that_jumps_for_seconds_is_reported():
    ahead = only(("GLOBAL_POSITION_INT", "ATTITUDE"), lambda message, _s, _r: later(message, 1800.0))
    flown = FaultedFlight(Scenario(1, "px4", 100.0), [Fault("clock", BEGIN_S, BEGIN_S + 6.0, ahead)]).fly()
    gone, back = [(at_s, one) for at_s, one in flown.health if one.input is Input.CLOCK]
    assert gone[1].state is InputState.INCONSISTENT
    assert "s ahead, nothing is decided on it" in gone[1].text
    assert gone[0] <= BEGIN_S + 5.0
    assert back[1].state is InputState.OK
    assert back[0] <= BEGIN_S + 10.0


def velocity(by):
    return only(("GLOBAL_POSITION_INT",), lambda m, _s, _r: with_fields(m, **by(m.fields["vx"], m.fields["vy"])))


@pytest.mark.parametrize(
    "by",
    [lambda vx, vy: {"vx": -vx, "vy": -vy}, lambda vx, vy: {"vx": vy, "vy": vx}, lambda vx, vy: {"vx": 0, "vy": 0}],
    ids=["reversed", "east and north exchanged", "zero"],
)
def test_velocity_that_contradicts_the_positions_is_reported(by):
    """The estimation interpolates positions by it: the target had been 50 m off, without a word."""
    flown = FaultedFlight(Scenario(1, "px4", 120.0), [Fault("velocity", BEGIN_S, math.inf, velocity(by))]).fly()
    found_s = [
        at_s
        for at_s, one in flown.health
        if one.input is Input.POSITION and "otherwise than the reported velocity" in one.text
    ]
    assert BEGIN_S < found_s[0] <= BEGIN_S + 20.0
    assert flown.unknown_s >= 0.8 * (120.0 - found_s[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (velocity(lambda vx, vy: {"vx": -vx, "vy": -vy}), "the velocity jumped by 2"),
        (
            only(
                ("GLOBAL_POSITION_INT",),
                lambda m, _s, _r: with_fields(m, relative_alt=m.fields["relative_alt"] + 50_000),
            ),
            "the height jumped by 50 m",
        ),
        (only(("GLOBAL_POSITION_INT",), lambda m, _s, _r: moved(m, 300.0, 0.0)), "the position jumped by 30"),
    ],
    ids=["velocity", "height", "position"],
)
def test_what_has_jumped_is_named(change, words):
    flown = FaultedFlight(Scenario(1, "px4", 70.0), [Fault("jump", BEGIN_S, math.inf, change)]).fly()
    assert any(words in text for _, text in flown.announced)


@pytest.mark.parametrize(
    ("ground_m", "is_wrong"), [(0.0, False), (-15.0, False), (-35.0, True), (-120.0, True), (math.nan, False)]
)
def test_elevation_data_that_contradicts_laser_and_gimbal_is_reported(ground_m, is_wrong):
    flight = FaultedFlight(Scenario(1, "px4", 90.0))
    flight.controller.tracker.payload.ground = lambda _east_m, _north_m: ground_m
    reported = [one.input for _, one in flight.fly().health]
    assert reported == ([Input.TERRAIN] if is_wrong else [])


def test_rate_of_each_input_is_known():
    health, laser = Health(PayloadFit()), Source("DISTANCE_SENSOR", 154, 1, 100)
    for k in range(200):
        now_s = 0.1 * k
        health.received(RangeReading(now_s, 200.0 + k, laser), now_s)
        health.changes(now_s, *selectors(laser))
    (report,) = health.reports
    assert report.input is Input.LASER
    assert report.rate_hz == pytest.approx(10.0, rel=0.05)


def circled(target_at, late_s=0.0):
    """Yield time and payload check after each moment of a minute in which the aircraft circles next to a target."""
    payload, source = PayloadFit(), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    laser = Source("DISTANCE_SENSOR", 154)
    for k in range(600):
        time_s = 0.1 * k
        course_rad = 0.25 * time_s
        east_m, north_m = 60.0 * math.sin(course_rad - math.pi / 2), 60.0 * math.cos(course_rad - math.pi / 2)
        speed = (15.0 * math.sin(course_rad), 15.0 * math.cos(course_rad))
        then_rad = course_rad - 0.25 * late_s - math.pi / 2
        dx, dy = np.array(target_at(time_s)) - (60.0 * math.sin(then_rad), 60.0 * math.cos(then_rad))
        yaw_rad, pitch_rad = math.atan2(dx, dy), -math.atan2(80.0, math.hypot(dx, dy))
        cy, sy, cp, sp = (f(a / 2) for a in (yaw_rad, pitch_rad) for f in (math.cos, math.sin))
        payload.attitude(AttitudeReading(time_s, 0.4, 0.0, course_rad))
        payload.position(PositionReading(time_s, east_m, north_m, 80.0, *speed, 0.0))
        payload.range(RangeReading(time_s, math.sqrt(dx * dx + dy * dy + 6400.0), laser))
        payload.gimbal(GimbalReading(time_s, (cy * cp, -sy * sp, cy * sp, sy * cp), "earth", source))
        yield time_s, payload


@pytest.mark.parametrize("late_s", [-1.0, 1.0, 2.0, 3.0])
def test_late_payload_does_not_look_like_a_yaw_error(late_s):
    """By 3 s, the line of sight lags by 43 degrees of the circle."""
    for time_s, payload in circled(lambda time_s: (250.0, time_s), late_s):
        assert not any((payload.laser_fault, payload.gimbal_fault, payload.terrain_fault)), time_s


def test_target_that_turns_does_not_look_like_a_wrong_frame():
    """A car that drives a U-turn while the aircraft circles keeps the verdict clear."""

    def turning(time_s):
        turn_rad = min(max(time_s - 25.0, 0.0) * 0.5, math.pi)
        return 250.0 + 10.0 * math.sin(turn_rad), 8.0 * min(time_s, 25.0) + 10.0 * math.cos(turn_rad)

    for time_s, payload in circled(turning):
        assert not any((payload.laser_fault, payload.gimbal_fault, payload.terrain_fault)), time_s


@pytest.mark.parametrize("seed", [11, 35, 93])
def test_laser_that_often_meets_something_else_ends_no_flight(seed):
    """Leaves and walls, half a second each: the fit drops its samples that were outliers while it looks at them."""
    rng, until_s, off_m = np.random.default_rng(seed), 15.0, 0.0

    def scattered(time_s):
        nonlocal until_s, off_m
        if time_s >= until_s:
            off_m = rng.normal(0.0, 60.0) if rng.random() < 0.3 else 0.0
            until_s = time_s + rng.exponential(0.5)
        return 250.0 + off_m, 0.0

    for time_s, payload in circled(scattered):
        assert not payload.laser_fault, time_s


def test_wrong_mounting_of_the_gimbal_is_reported():
    """On a steady circle it looks like late stamps; the first change of circle shows the difference."""
    flown = FaultedFlight(Scenario(1, "px4", 260.0), [Fault("mount", 0.0, math.inf, turned(20.0))]).fly()
    (text,) = [text for _, text in flown.announced if text.startswith("the gimbal's yaw is off by about")]
    assert "+20 degrees, and corrected: check its mounting and the aircraft's heading, or correct" in text


@pytest.mark.parametrize(
    ("begin_s", "error_deg"), [(0.0, 40.0), (BEGIN_S, 40.0), (BEGIN_S, 90.0), (0.0, 180.0), (BEGIN_S, -120.0)]
)
def test_very_wrong_mounting_of_the_gimbal_is_soon_reported_and_corrected(begin_s, error_deg):
    fault = Fault("mount", begin_s, math.inf, turned(error_deg))
    flight = FaultedFlight(Scenario(1, "px4", DURATION_S), [fault])
    flown = flight.fly()
    found = re.compile("the gimbal's yaw is off by about (.*) degrees, and corrected")
    found_s, text = next((time_s, match[1]) for time_s, text in flown.announced if (match := found.match(text)))
    assert begin_s < found_s <= begin_s + (20.0 if error_deg == 40.0 else 15.0)
    assert abs((float(text) - error_deg + 180.0) % 360.0 - 180.0) < 10.0
    off_rad = flight.controller.tracker.calibration.yaw_bias_rad - math.radians(error_deg)
    assert abs(math.remainder(off_rad, math.tau)) < math.radians(1.0)
    later_m = [one.target_error_m for one in flown.decided if one.time_s > found_s + 20.0]
    assert np.median(later_m) < 5.0
    assert min(flown.range_m) > 80.0
    assert not [text for time_s, text in flown.announced if time_s > found_s and "may follow another object" in text]


def test_mounting_of_the_gimbal_that_is_put_right_in_flight_is_noticed():
    fault = Fault("mount", BEGIN_S, BEGIN_S + 40.0, turned(90.0))
    flown = FaultedFlight(Scenario(1, "px4", DURATION_S), [fault]).fly()
    announced = [(time_s, text) for time_s, text in flown.announced if text.startswith("the gimbal's yaw")]
    assert [text for _, text in announced][1:] == ["the gimbal's yaw needs no correction any more"]
    assert BEGIN_S + 40.0 < announced[1][0] <= BEGIN_S + 75.0
    later_m = [one.target_error_m for one in flown.decided if one.time_s > BEGIN_S + 85.0]
    assert np.median(later_m) < 5.0


LARGE_ERRORS = {
    "ranges 1.5 times the distance": (scaled(1.5), "the laser's ranges are about (.*) times", 1.5),
    "ranges 0.7 times the distance": (scaled(0.7), "the laser's ranges are about (.*) times", 0.7),
    "ranges 50 m too short": (scaled(1.0, -50.0), "the laser's ranges are off by about (.*) m,", -50.0),
    "yaw off by 20 degrees to the left": (turned(-20.0), "the gimbal's yaw is off by about (.*) degrees", -20.0),
}


@pytest.mark.parametrize("name", LARGE_ERRORS)
def test_large_error_of_the_payload_is_reported_and_corrected(name):
    change, words, error = LARGE_ERRORS[name]
    flown = FaultedFlight(Scenario(3, "arduplane", 300.0), [Fault(name, BEGIN_S, math.inf, change)]).fly()
    found = [float(match[1]) for _, text in flown.announced if (match := re.match(words, text))]
    assert found[-1] == pytest.approx(error, rel=0.2)
    assert min(flown.range_m) > 80.0
    later_m = [one.target_error_m for one in flown.decided if one.time_s > BEGIN_S + 120.0]
    assert np.median(later_m) < 15.0  # without the correction 30 to 100 m


def _error_m(flight: FaultedFlight) -> float:
    """Return how far off the estimate is; NaN without one."""
    truth, estimate = flight.simulated.target.at(flight.simulated.time_s), flight.controller.estimate
    return (
        math.nan if estimate is None else math.hypot(estimate.east_m - truth.east_m, estimate.north_m - truth.north_m)
    )


DRIFTS = {  # the time within which they are reported, and how far off the estimate then is for 95 % of the time, m
    "yaw, 0.05 degrees/s": (turning(0.05, 30.0), "the gimbal's yaw drifts", 105.0, 15.0),
    "yaw, -0.2 degrees/s": (turning(0.2, -30.0), "the gimbal's yaw drifts", 72.0, 25.0),
    "range, 0.3 m/s": (lengthening(0.3, 90.0), "the laser's ranges drift", 140.0, 25.0),
    "range, -0.3 m/s": (lengthening(0.3, -90.0), "the laser's ranges drift", 140.0, 25.0),
    "pitch, 0.1 degrees/s": (pitching(0.1, 15.0), "the gimbal's pitch drifts", 125.0, 25.0),
    "height, 0.3 m/s": (rising(0.3, 60.0), "the gimbal's pitch drifts", 165.0, 10.0),
}


@pytest.mark.parametrize("name", DRIFTS)
def test_error_that_drifts_is_reported_and_the_watch_goes_on(name):
    """Without the correction the estimate errs by 150 m of yaw and 90 m of range."""
    change, words, within_s, most_m = DRIFTS[name]
    flight = FaultedFlight(Scenario(1, "px4", 320.0), [Fault(name, BEGIN_S, math.inf, change)])
    errors_m, least_m = [], math.inf
    while flight.simulated.time_s < 319.9:
        flight.step()
        errors_m.append((flight.simulated.time_s, _error_m(flight)))
        if (own := flight.controller.aircraft) is not None:
            truth = flight.simulated.target.at(flight.simulated.time_s)
            least_m = min(least_m, math.hypot(own.east_m - truth.east_m, own.north_m - truth.north_m))
    found_s = next(time_s for time_s, text in flight.flown.announced if text.startswith(words))
    assert BEGIN_S < found_s <= BEGIN_S + within_s
    assert np.quantile([error_m for time_s, error_m in errors_m if time_s > found_s], 0.95) < most_m
    assert least_m > 80.0


@pytest.mark.parametrize(("of_nose", "centre_deg"), [(True, -90.0), (False, 90.0)])
def test_ranges_that_are_wrong_at_some_bearings_are_left_out_there(of_nose, centre_deg):
    """Until then they seem to be of another object; with all ranges the estimate errs by 40 m there."""
    change = wrong_at(centre_deg, 60.0, 1.15, of_nose=of_nose)
    flight = FaultedFlight(Scenario(3, "arduplane", 260.0), [Fault("window", BEGIN_S, math.inf, change)])
    errors_m, left_out = [], 0
    while flight.simulated.time_s < 259.9:
        flight.step()
        if flight.simulated.time_s > BEGIN_S + 80.0:
            errors_m.append(_error_m(flight))
            left_out += flight.controller.tracker.payload.wrong_bearings is not None
    (found_s, text), *_ = [one for one in flight.flown.announced if one[1].startswith("the laser's ranges")]
    assert BEGIN_S < found_s < BEGIN_S + 80.0
    assert f"to the right of {'the nose' if of_nose else 'north'}, and left out there" in text
    assert left_out == len(errors_m)
    assert np.quantile(errors_m, 0.95) < 10.0


def test_a_drift_counts_as_unknown_near_the_edge_of_the_band_before_it_is_certain():
    """The bound on the error grows with the drift; without one it is 0."""
    flight = FaultedFlight(Scenario(1, "px4", 200.0), [Fault("range", BEGIN_S, math.inf, lengthening(0.6, 90.0))])
    bounds_m, wrong_m = [], []
    while flight.simulated.time_s < 199.9 and not flight.controller.tracker.payload.drifts:
        flight.step()
        if flight.simulated.time_s > BEGIN_S + 30.0:
            wrong_m.append(_error_m(flight))
            bounds_m.append(flight.controller.tracker.payload.wander_m(flight.controller.time_s))
    late = [bound_m > 0.7 * error_m for bound_m, error_m in zip(bounds_m, wrong_m, strict=True) if error_m > 20.0]
    assert np.mean(late) > 0.4


def test_a_position_that_serves_two_samples_is_no_motion():
    check, place = PayloadFit(), PositionReading(0.0, 0.0, 0.0, 100.0, 15.0, 0.0, 0.0)
    check.position(place)
    for tick in range(12):
        time_s = 0.5 * tick
        if tick % 2 == 0:
            check.position(PositionReading(time_s, 7.5 * tick, 0.0, 100.0, 15.0, 0.0, 0.0))
        check.attitude(AttitudeReading(time_s, 0.0, 0.0, math.pi / 2))
        check.range(RangeReading(time_s, 300.0 if tick < 8 else 500.0, Source("DISTANCE_SENSOR", 154)))
        looks = (math.cos(0.02 * tick), 0.0, 0.0, math.sin(0.02 * tick))
        check.gimbal(GimbalReading(time_s, looks, "earth", Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)))
    assert check.gimbal_fault == check.laser_fault == ""


def test_range_that_looks_down_is_no_laser():
    health, (lasers, gimbals) = Health(PayloadFit()), selectors()
    for orientation, counted in ((25, False), (100, True)):
        for second in range(10):
            reading = RangeReading(float(second), 200.0, Source("DISTANCE_SENSOR", 1, 0, orientation))
            health.received(reading, float(second), lasers)
        health.changes(10.0, lasers, gimbals)
        assert (Input.LASER in {one.input for one in health.reports}) is counted

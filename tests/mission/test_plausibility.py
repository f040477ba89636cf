"""What the door lets in: one rule a test, with readings of an aircraft that circles at 20 m/s."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import pytest

from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
    TargetFixReading,
)
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.core.events import Event, NavigationReported, WindReported, YieldRequested
from sidelong.mission.core.inputs import Input

SPEED_M_S, RADIUS_M = 20.0, 80.0
LASER, GIMBAL = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
CAMERA = Source("CAMERA_TRACKING_GEO_STATUS", 100)
BANK_RAD = math.atan(SPEED_M_S**2 / (9.80665 * RADIUS_M))

Change = Callable[[Event], Event | None]


def position(time_s: float) -> PositionReading:
    turn_rad = time_s * SPEED_M_S / RADIUS_M
    return PositionReading(
        time_s,
        RADIUS_M * math.sin(turn_rad),
        RADIUS_M * math.cos(turn_rad),
        100.0,
        SPEED_M_S * math.cos(turn_rad),
        -SPEED_M_S * math.sin(turn_rad),
        0.0,
    )


def attitude(time_s: float) -> AttitudeReading:
    return AttitudeReading(time_s, BANK_RAD, 0.0, 0.0)


def laser(time_s: float, range_m: float = 250.0) -> RangeReading:
    return RangeReading(time_s, range_m, LASER, quality=0.9)


def gimbal(time_s: float) -> GimbalReading:
    return GimbalReading(time_s, (1.0, 0.0, 0.0, 0.0), "earth", GIMBAL)


class Flown:
    """What the door let in and reported."""

    def __init__(self) -> None:
        self.door = Plausibility(18.0)
        self.passed: list[Event] = []
        self.announced: list[str] = []
        self.doubts: list[str | None] = []
        self.clock_faults: set[str] = set()

    def give(self, *events: Event | None) -> Flown:
        for event in events:
            if event is None:
                continue
            passed, announced = self.door.admit(event)
            if passed is not None:
                self.passed.append(passed)
            self.announced += [announcement.text for announcement in announced]
            self.doubts.append(self.door.doubt)
            self.clock_faults.add(self.door.input_faults[Input.CLOCK])
        return self

    def fly(self, begin_s: float, end_s: float, change: Change = lambda event: event) -> Flown:
        """Give attitudes and positions at 10 Hz, and a payload 0.05 s later, each as ``change`` leaves it."""
        for tick in range(round(begin_s * 10), round(end_s * 10)):
            now_s = tick / 10
            vehicle = attitude(now_s), position(now_s)
            self.give(*map(change, (*vehicle, gimbal(now_s - 0.05), laser(now_s - 0.05))))
        return self

    def of(self, kind: type) -> list:
        return [event for event in self.passed if isinstance(event, kind)]


@pytest.fixture
def flown() -> Flown:
    return Flown().fly(100.0, 110.0)


def only(kinds: type | tuple[type, ...], by: Callable) -> Change:
    return lambda event: by(event) if isinstance(event, kinds) else event


def later(seconds: float) -> Callable:
    return lambda event: replace(event, time_s=event.time_s + seconds)


def away(east_m: float) -> Change:
    return only(PositionReading, lambda reading: replace(reading, east_m=reading.east_m + east_m))


def off_the_path(readings: Iterable[PositionReading]) -> float:
    true = ((reading, position(reading.time_s)) for reading in readings)
    return max(math.hypot(a.east_m - b.east_m, a.north_m - b.north_m) for a, b in true)


VEHICLE = (AttitudeReading, PositionReading)
PAYLOAD = (RangeReading, GimbalReading)


def test_what_is_plausible_passes_unchanged(flown):
    assert len(flown.passed) == 400
    assert not flown.announced
    assert flown.of(PositionReading) == [position(tick / 10) for tick in range(1000, 1100)]


# -- the payload's clock -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ahead_s", [3600.0, 30.0, 4_294_857.0, -60.0, -3600.0])
def test_one_wrong_stamp_of_the_payload_is_refused_and_reported(flown, ahead_s):
    flown.give(laser(109.95 + ahead_s), gimbal(109.95 + ahead_s)).fly(110.0, 120.0)
    assert max(reading.time_s for reading in flown.of(RangeReading)) == pytest.approx(119.85)
    assert len(flown.of(RangeReading)) == 200
    way = "ahead" if ahead_s > 0 else "behind"
    assert any("laser's clock" in text and way in text and "refused" in text for text in flown.announced)


@pytest.mark.parametrize("ahead_s", [3600.0, -3600.0, 7.0, 2.0, -2.5, -1800.0])
def test_a_payload_with_a_clock_of_its_own_is_corrected_and_reported(flown, ahead_s):
    flown.fly(110.0, 130.0, only(PAYLOAD, later(ahead_s)))
    corrected = [reading for reading in flown.of(RangeReading) if reading.time_s > 115.0]
    assert len(corrected) >= 140
    apart_s = [min(abs(reading.time_s - (tick / 10 - 0.05)) for tick in range(1100, 1300)) for reading in corrected]
    assert max(apart_s) < 0.06
    assert any("laser's clock" in text and "corrected" in text for text in flown.announced)
    assert len(flown.announced) <= 4


def test_a_payload_that_starts_again_is_followed(flown):
    flown.fly(110.0, 125.0, only(PAYLOAD, later(-105.0)))
    assert flown.of(RangeReading)[-1].time_s == pytest.approx(124.85, abs=0.06)


def test_a_payload_that_comes_right_is_accepted_at_once(flown):
    flown.fly(110.0, 125.0, only(PAYLOAD, later(3600.0))).fly(125.0, 140.0)
    assert len([reading for reading in flown.of(RangeReading) if reading.time_s >= 124.9]) >= 150
    assert any("agrees with the aircraft's again" in text for text in flown.announced)


def test_a_payload_without_a_clock_is_taken_as_of_now(flown):
    flown.fly(110.0, 111.0, only(PAYLOAD, lambda reading: replace(reading, time_s=0.0)))
    assert [reading.time_s for reading in flown.of(RangeReading)[-10:]] == [tick / 10 for tick in range(1100, 1110)]


def test_a_silent_vehicle_is_no_measure_of_the_payload(flown):
    flown.fly(110.0, 125.0, lambda event: None if isinstance(event, VEHICLE) else event)
    assert not any("corrected" in text for text in flown.announced)
    assert max(reading.time_s for reading in flown.of(RangeReading)) < 112.2


# -- the vehicle's clock -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ahead_s", [3600.0, 30.0, 4_294_857.0, -50.0, -100.0])
def test_one_wrong_stamp_of_the_vehicle_is_refused(flown, ahead_s):
    flown.give(later(ahead_s)(position(109.95)), later(ahead_s)(attitude(109.95))).fly(110.0, 111.0)
    assert flown.of(PositionReading)[-1] == position(110.9)
    assert max(reading.time_s for reading in flown.of(PositionReading)) == 110.9
    assert len(flown.of(RangeReading)) == 110


@pytest.mark.parametrize("ahead_s", [3600.0, -1800.0, 45.0])
def test_a_clock_that_is_wrong_for_seconds_is_reported_and_not_followed(ahead_s):
    flown = Flown().fly(2000.0, 2010.0).fly(2010.0, 2020.0, only(VEHICLE, later(ahead_s)))
    assert max(reading.time_s for reading in flown.of(PositionReading)) < 2010.0
    assert any("nothing is decided on it" in fault for fault in flown.clock_faults)
    flown.fly(2020.0, 2022.0)
    assert flown.of(PositionReading)[-1].time_s == 2021.9
    assert not flown.of(YieldRequested)


def test_a_jump_that_meets_a_change_of_clock_is_still_a_jump(flown):
    def wrong(event: Event) -> Event:
        return away(1400.0)(later(2.7)(event) if isinstance(event, VEHICLE) else event)

    flown.fly(110.0, 115.0, only(VEHICLE, later(2.7))).fly(115.0, 118.0, wrong).fly(118.0, 122.0, away(1400.0))
    assert not [reading for reading in flown.of(PositionReading) if reading.east_m > 500.0]
    flown.fly(122.0, 130.0)
    assert flown.of(PositionReading)[-1] == position(129.9)


@pytest.mark.parametrize("jump_ends_s", [112.0, 114.0, 119.0])
def test_a_jump_is_no_flight_of_a_clock_that_goes_ahead(flown, jump_ends_s):
    def wrong(event: Event) -> Event:
        begun_s = event.time_s
        if isinstance(event, VEHICLE):
            event = later(57.3 if 111.5 <= begun_s < 116.3 else 0.0)(event)
        return away(2700.0 if begun_s < jump_ends_s else 0.0)(event)

    flown.fly(110.0, 125.0, wrong)
    assert not [reading for reading in flown.of(PositionReading) if reading.east_m > 1000.0 or reading.time_s > 125.0]
    assert any("nothing is decided on it" in fault for fault in flown.clock_faults)
    assert flown.of(PositionReading)[-1] == position(124.9)


def test_nothing_is_seen_from_a_place_whose_clock_stood_still(flown):
    flown.fly(110.0, 116.1, only(VEHICLE, later(-4.3)))
    taken = flown.door.position.accepted
    assert math.hypot(taken.east_m - position(116.0).east_m, taken.north_m - position(116.0).north_m) > 40.0
    assert not flown.door.place_is_known
    flown.fly(116.1, 118.0)
    assert flown.door.place_is_known


@pytest.mark.parametrize(("silent_s", "restarted"), [(0.0, False), (7.1, True)])
def test_whoever_has_started_again_seconds_ago_has_moved_in_the_meantime(flown, silent_s, restarted):
    begin_s = 110.0 + silent_s
    flown.fly(begin_s, begin_s + 6.0, only(VEHICLE, later(7.1 - begin_s)))
    assert bool(flown.of(YieldRequested)) is restarted
    flown.fly(begin_s + 6.0, begin_s + 10.0)
    assert bool(flown.of(YieldRequested)) is restarted


def test_no_place_is_bridged_from_a_clock_that_came_back_from_ahead(flown):
    flown.fly(114.0, 119.6, only(VEHICLE, later(7.7)))
    for tick in range(1196, 1300):
        now_s = tick / 10
        flown.give(attitude(now_s), position(now_s))
        taken, here = flown.door.position.accepted, position(now_s)
        if now_s > 127.3 and math.hypot(taken.east_m - here.east_m, taken.north_m - here.north_m) > 30.0:
            assert flown.door.doubt is not None
    assert any("holding the circle" in text for text in flown.announced)


def test_the_clock_goes_on_after_a_silence(flown):
    flown.fly(137.0, 140.0)
    assert flown.of(PositionReading)[-1].time_s == 139.9
    assert len([reading for reading in flown.of(PositionReading) if reading.time_s > 136.0]) >= 24
    assert not flown.of(YieldRequested)
    assert flown.door.doubt is None


def test_a_slow_link_may_lose_a_message_or_two():
    flown = Flown()
    lost = {107.0, 112.0, 113.0, 121.0}
    for second in range(100, 130):
        if float(second) not in lost:
            flown.give(attitude(float(second)), position(float(second)), laser(second - 0.2))
    assert len(flown.of(PositionReading)) == len(flown.of(RangeReading)) == 26
    assert not flown.announced


def test_a_long_silence_takes_longer_to_accept(flown):
    flown.fly(1100.0, 1115.0)
    assert flown.of(PositionReading)[-1].time_s < 111.0
    flown.fly(1115.0, 1125.0)
    assert flown.of(PositionReading)[-1].time_s == 1124.9


def test_an_autopilot_that_starts_again_is_reported_within_seconds(flown):
    flown.fly(0.3, 1.5)
    assert not flown.of(YieldRequested)
    flown.fly(1.5, 3.5)
    assert [event.reason for event in flown.of(YieldRequested)] == ["the autopilot has restarted"]


def test_the_ekf_of_a_restarted_autopilot_recovers_without_a_jump():
    flown = Flown()
    for second in (*range(100, 130), *range(40)):
        fault = "the EKF does not know its position" if second < 25 else ""
        flown.give(attitude(second), position(second), NavigationReported(float(second), "EKF", fault))
    assert flown.of(YieldRequested)
    assert not [text for text in flown.announced if "jumped" in text]
    assert flown.door.doubt is None


# -- the place ---------------------------------------------------------------------------------------------


def test_a_jump_of_the_height_is_reported_with_its_size(flown):
    def fallen(event):
        return replace(event, height_m=0.0) if isinstance(event, PositionReading) else event

    flown.fly(110.0, 115.0, fallen)
    assert "the height jumped by 100 m" in flown.announced[0]


@pytest.mark.parametrize("jump_m", [100.0, -1500.0, 10_000.0, 15_000_000.0])
@pytest.mark.parametrize("length_s", [0.1, 1.5, 10.0])
def test_a_jump_of_the_position_is_bridged_and_then_rejected(flown, jump_m, length_s):
    flown.fly(110.0, 110.0 + length_s, away(jump_m))
    assert off_the_path(flown.of(PositionReading)) < 5.0
    assert (flown.door.doubt is not None) == (length_s > 3.0)
    flown.fly(110.0 + length_s, 125.0)
    assert flown.of(PositionReading)[-1] == position(124.9)
    assert flown.door.doubt is None
    assert "jumped by" in flown.announced[0]
    assert flown.announced[-1] == "the aircraft's position is accepted again" or length_s < 3.0


def test_with_the_velocity_lost_as_well_the_bank_reports_the_turn(flown):
    def nonsense(reading: PositionReading) -> PositionReading:
        return replace(reading, east_m=reading.east_m + 900.0, velocity_east_m_s=140.0, velocity_north_m_s=-80.0)

    flown.fly(110.0, 120.0, only(PositionReading, nonsense))
    assert off_the_path(flown.of(PositionReading)) < 10.0
    assert flown.fly(120.0, 121.0).of(PositionReading)[-1] == position(120.9)


def test_a_new_place_that_holds_is_accepted(flown):
    flown.fly(110.0, 124.0, away(300.0))
    assert flown.door.doubt is not None
    flown.fly(124.0, 127.0, away(300.0))
    assert flown.door.doubt is None
    assert flown.of(PositionReading)[-1].east_m == pytest.approx(position(126.9).east_m + 300.0)


def test_after_a_silence_a_circling_aircraft_is_accepted_where_it_circled(flown):
    flown.fly(133.0, 136.0)
    assert flown.of(PositionReading)[-1] == position(135.9)
    assert flown.door.doubt is None
    assert not flown.announced


def test_a_jump_that_meets_a_silence_is_still_a_jump(flown):
    flown.fly(133.0, 138.0, away(614.0))
    assert flown.door.doubt is not None
    assert "jumped by" in flown.announced[0]
    flown.fly(138.0, 160.0)
    assert flown.door.doubt is None
    assert flown.of(PositionReading)[-1] == position(159.9)


def test_a_jump_off_the_circle_during_a_silence_is_nothing_that_has_drifted(flown):
    lap_s = round(20.0 * math.pi * RADIUS_M / SPEED_M_S) / 10.0
    silent_s = lap_s * math.ceil(25.0 / lap_s)  # it comes back with the velocity that it had
    there, begin_s = flown.door.position.accepted, 109.9 + silent_s
    reckoned_m = silent_s * there.velocity_east_m_s, silent_s * there.velocity_north_m_s

    def jumped(event: Event) -> Event:
        if not isinstance(event, PositionReading):
            return event
        return replace(event, east_m=event.east_m + reckoned_m[0], north_m=event.north_m + reckoned_m[1] + 90.0)

    flown.fly(begin_s, begin_s + 6.0, jumped)
    assert flown.door.doubt is not None
    flown.fly(begin_s + 6.0, begin_s + 25.0)
    assert flown.of(PositionReading)[-1] == position(begin_s + 24.9)


def test_a_new_place_is_not_accepted_while_the_ekf_complains(flown):
    for begin_s in range(110, 150):
        flown.give(NavigationReported(float(begin_s), "EKF", "the EKF sees a GPS glitch"))
        flown.fly(begin_s, begin_s + 1, away(300.0))
    assert flown.door.doubt == "the EKF sees a GPS glitch"


def test_the_first_place_is_given_up_for_one_that_more_agree_with():
    flown = Flown().give(attitude(99.9), replace(position(99.9), east_m=9_000.0)).fly(100.0, 102.0)
    assert flown.door.doubt is None
    assert flown.of(PositionReading)[-1] == position(101.9)


@pytest.mark.parametrize("source", ["GPS", "EKF"])
def test_a_fault_that_is_reported_is_rejected_after_some_seconds_until_it_is_over(flown, source):
    flown.give(NavigationReported(110.0, source, "no fix")).fly(110.0, 112.0)
    assert flown.door.doubt is None
    flown.give(NavigationReported(112.0, source, "no fix")).fly(112.0, 114.0)
    assert flown.door.doubt == "no fix"
    assert "no fix: holding the circle, nothing is decided on it" in flown.announced
    flown.give(NavigationReported(114.0, source)).fly(114.0, 115.0)
    assert flown.door.doubt is None


def test_a_fault_lasts_by_the_clock_that_is_accepted(flown):
    for begin_s in range(110, 116):
        flown.give(NavigationReported(begin_s + 42.7, "GPS", "no fix")).fly(begin_s, begin_s + 1)
    assert flown.door.doubt == "no fix"


def test_a_place_may_have_drifted_since_the_last_good_word(flown):
    flown.give(NavigationReported(109.9, "EKF")).fly(119.0, 120.0, away(5.0))
    flown.give(NavigationReported(120.0, "EKF", "no position")).fly(120.0, 121.0, away(70.0))
    assert flown.door.faulty
    flown.give(NavigationReported(121.0, "EKF")).fly(121.0, 122.0)
    assert not flown.door.faulty
    assert flown.of(PositionReading)[-1] == position(121.9)


def test_after_a_silence_nothing_is_seen_from_a_place_before_gps_and_ekf_have_spoken(flown):
    flown.give(NavigationReported(109.9, "GPS"), NavigationReported(109.9, "EKF")).fly(130.0, 131.0)
    assert flown.of(PositionReading)[-1] == position(130.9)
    assert not flown.door.place_is_known
    flown.give(NavigationReported(130.9, "GPS")).fly(131.0, 131.5)
    assert not flown.door.place_is_known
    flown.give(NavigationReported(131.4, "EKF")).fly(131.5, 132.0)
    assert flown.door.place_is_known


def test_who_reports_nothing_more_of_gps_and_ekf_is_not_waited_for_long(flown):
    flown.give(NavigationReported(109.9, "GPS")).fly(130.0, 137.0)
    assert flown.door.place_is_known
    assert not flown.announced


def test_a_velocity_that_was_accepted_wrongly_leads_nowhere(flown):
    flown.give(NavigationReported(110.0, "EKF", "no position")).fly(110.0, 110.1)
    flown.give(NavigationReported(110.1, "EKF"))  # from now on the place may have drifted
    flown.give(attitude(110.1), replace(position(110.1), velocity_east_m_s=0.0, velocity_north_m_s=0.0))
    flown.fly(110.2, 112.0)
    assert flown.of(PositionReading)[-18:] == [position(tick / 10) for tick in range(1102, 1120)]
    assert flown.door.doubt is None


# -- two vehicles ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("apart_s", [400.0, -80.0, 3600.0])
def test_two_clocks_that_take_turns_are_two_vehicles(flown, apart_s):
    for tick in range(1100, 1120):
        now_s = tick / 10
        other = replace(later(apart_s)(position(now_s)), east_m=50.0)
        flown.give(attitude(now_s), position(now_s), later(apart_s)(attitude(now_s)), other)
    (event,) = flown.of(YieldRequested)
    assert "two vehicles speak with the same system id" in event.reason
    assert event.time_s < 112.0
    assert flown.door.two_vehicles


def test_two_places_that_take_turns_are_two_vehicles(flown):
    for tick in range(1100, 1200):
        now_s = tick / 10
        flown.give(attitude(now_s), position(now_s), away(2000.0)(position(now_s + 0.03)))
    (event,) = flown.of(YieldRequested)
    assert "take turns, 2000 m apart" in event.reason
    assert off_the_path(flown.of(PositionReading)) < 5.0


@pytest.mark.parametrize("change", [later(3600.0), away(500.0)])
def test_second_vehicle_that_is_seldom_received_is_reported(flown, change):
    for begin_s in range(110, 140):
        flown.give(change(position(begin_s + 0.02)))
        flown.fly(begin_s + 0.1, begin_s + 1)
    assert any("a second vehicle may send with the same system id" in announced for announced in flown.announced)
    assert not flown.of(YieldRequested)


def test_a_few_stray_stamps_and_places_are_no_second_vehicle(flown):
    for begin_s in range(110, 170):
        flown.give(later(3600.0)(position(begin_s)), away(500.0)(position(begin_s + 0.02)))
        flown.fly(begin_s + 0.1, begin_s + 1)
    assert not flown.of(YieldRequested)


# -- magnitudes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "event",
    [
        WindReported(110.0, 30.0, 0.0),
        WindReported(110.0, 1e30, -1e30),
        laser(109.95, 1e30),
        replace(laser(109.95), sigma_m=1e9),
        TargetFixReading(109.95, 9e6, 0.0, 5.0, CAMERA),
        TargetFixReading(109.95, 100.0, 0.0, 1e9, CAMERA),
        TargetFixReading(109.95, 100.0, 0.0, 0.0, CAMERA),
        replace(attitude(110.0), roll_rad=1e20),
    ],
)
def test_what_nothing_can_measure_is_no_reading(flown, event):
    before = len(flown.passed)
    assert len(flown.give(event).passed) == before


@pytest.mark.parametrize(
    "change",
    [{"height_m": 60_000.0}, {"velocity_east_m_s": 327.0}, {"velocity_up_m_s": -300.0}, {"north_m": 8e6}],
)
def test_a_position_that_no_aircraft_can_have_is_never_accepted(flown, change):
    flown.fly(110.0, 160.0, only(PositionReading, lambda reading: replace(reading, **change)))
    assert flown.door.doubt is not None
    assert not [reading for reading in flown.of(PositionReading) if abs(reading.height_m) > 1000.0]


def test_this_many_sources_and_no_more_are_kept(flown):
    for component in range(200):
        flown.give(replace(laser(109.95), source=Source("DISTANCE_SENSOR", component, 1)))
    assert len({reading.source for reading in flown.of(RangeReading)}) <= 32


def test_second_beacon_is_reported_and_not_used_while_the_first_is_received(flown):
    """The mean of two targets is where neither of them is."""
    for second in range(110, 200):
        flown.fly(float(second), second + 1.0)
        numbers = (1, 2) if second < 125 else (2,)
        for number in numbers:
            place = Source("TARGET_ABSOLUTE", 1, number)
            flown.give(TargetFixReading(second + 0.5, 80.0 * number, float(second), 2.0, place))
    used = [one.source.sensor_id for one in flown.of(TargetFixReading)]
    assert used[:15] == 15 * [1]
    assert 10 <= len(used[15:]) <= 20
    assert set(used[15:]) == {2}
    assert "a second beacon (TARGET_ABSOLUTE 2, component 1) is not used" in flown.announced

"""Flights over bad links: reported as they are flown, yielded when another takes over, repeated to the last bit."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.mission.core.events import ActivatePlan, Announce, Command, PlanStatus, UploadPlan, Yield
from sidelong.mission.exchange.mission_controller import DERIVED
from sidelong.mission.exchange.outbox import ExternalControl, SendMessage, TakeoverFailed
from sidelong.sitl.settings import LinkFaults

BAD = LinkFaults(loss=0.05, duplicate=0.05, delay_s=0.1)
SLOW = LinkFaults(loss=0.05, delay_s=1.0)


def statuses(flight, stage):
    return [one.number for one in flight.found(PlanStatus) if one.stage == stage]


@pytest.mark.parametrize(
    ("flavour", "guidance"), [("arduplane", "mission"), ("px4", "mission"), ("arduplane", "command")]
)
def test_a_replay_repeats_uploads_and_switches_to_the_last_bit(in_the_air, tmp_path, flavour, guidance):
    flight = in_the_air(flavour, faults=BAD, guidance=guidance)
    flight.run(60.0)
    assert len(statuses(flight, "departed")) >= 2
    assert flight.core.loaded
    assert not flight.found(Yield)
    assert not [one for one in flight.found(Announce) if "another station" in one.text]
    replay = flight.replayed(tmp_path / "journal.jsonl")
    assert replay.difference is None
    assert replay.compared >= len(flight.found((SendMessage, Command, *DERIVED, TakeoverFailed)))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_the_circle_is_taken_over_again_in_two_round_trips(in_the_air, flavour):
    flight = in_the_air(flavour)
    flight.run(5.0)
    flight.core = flight.make_core(flight.planner)  # as a program that was started again
    flight.forget_outputs()
    flight.spoil(LinkFaults(delay_s=0.4))
    flight.run(2.0)
    begun_s = flight.link_s
    flight.take_over(flight.dialect.mission_mode, round_trip_s=0.8)
    assert flight.run(10.0, lambda: flight.has_control)
    assert flight.link_s - begun_s < 2.0
    asked = [one.name for one in flight.found(SendMessage)]
    assert asked.count("MISSION_REQUEST_LIST") == 1
    assert "MISSION_COUNT" not in asked


def test_a_mission_after_one_that_px4_does_not_fly_is_started_as_soon_as_it_looks_at_it(in_the_air):
    flight = in_the_air("px4")
    flight.run(5.0)
    foreign = flight.autopilot.mission
    kept = list(foreign.items())[:-1]  # no landing
    foreign.begin(len(kept))
    for index, item in enumerate(kept):
        foreign.put(index, item, current=index == 0)
    foreign.finish()
    flight.core = flight.make_core(flight.planner)
    flight.forget_outputs()
    flight.take_over("LOITER")
    assert flight.run(10.0, lambda: flight.has_control)
    assert not flight.found(TakeoverFailed)


@pytest.mark.parametrize(
    ("flavour", "seed", "for_s"), [("arduplane", 1, 100.0), ("px4", 1, 100.0), ("px4", 8, 160.0)]
)
def test_at_a_second_of_delay_every_switch_is_reported_as_flown(in_the_air, flavour, seed, for_s):
    flight = in_the_air(flavour, seed=seed, faults=SLOW)
    flight.run(for_s)
    flight.spoil(LinkFaults())
    flight.run(10.0)
    activated = [one.number for one in flight.found(ActivatePlan)]
    assert len(activated) >= 3
    assert set(activated) <= set(statuses(flight, "departed"))
    assert not flight.found(Yield)


def test_a_switch_is_confirmed_by_the_track_alone(in_the_air):
    flight = in_the_air("arduplane")
    flight.autopilot.silenced.add(42)
    flight.autopilot.broadcast_now = lambda _id: None
    flight.run(100.0)
    assert len(statuses(flight, "departed")) >= 2
    assert not flight.found(Yield)


def test_a_switch_that_is_never_received_is_an_open_question_until_it_is_answered(in_the_air):
    flight = in_the_air("arduplane")
    set_current = flight.autopilot.set_current_item
    flight.autopilot.set_current_item = lambda _index: False
    assert flight.run(60.0, lambda: statuses(flight, "failed"))
    assert statuses(flight, "unconfirmed") == statuses(flight, "failed")
    number = statuses(flight, "failed")[-1]
    # It is taken after all, much later than anyone expected it.
    set_current(flight.core._backend._change.layout.first)
    assert flight.run(10.0, lambda: number in statuses(flight, "departed"))
    assert not flight.found(Yield)


def test_a_switch_is_taken_after_all_when_the_next_plan_is_on_its_way(in_the_air):
    flight = in_the_air("arduplane")
    set_current = flight.autopilot.set_current_item
    flight.autopilot.set_current_item = lambda _index: False
    assert flight.run(60.0, lambda: statuses(flight, "failed"))
    number, layout = statuses(flight, "failed")[-1], flight.core._backend._change.layout
    uploads = len(flight.found(UploadPlan))
    assert flight.run(60.0, lambda: len(flight.found(UploadPlan)) > uploads)
    set_current(layout.first)
    assert flight.run(10.0, lambda: number in statuses(flight, "departed"))
    assert not flight.found(Yield)


def test_late_reports_of_the_line_before_are_no_other_station(in_the_air):
    flight = in_the_air("arduplane")
    flight.autopilot.silenced.add(42)  # the switch is confirmed by the track
    flight.autopilot.broadcast_now = lambda _id: None
    before = flight.core._backend._current
    assert flight.run(60.0, lambda: bool(statuses(flight, "departed")))
    assert before.seq not in flight.core._backend.layout
    for _ in range(6):
        flight.put(replace(before, time_s=flight.telemetry.now_s, link_s=flight.link_s))
        flight.run(0.4)
    assert not flight.found((Yield, ExternalControl))


def test_late_reports_of_a_mission_that_was_replaced_are_no_other_station(in_the_air):
    flight = in_the_air("px4")
    before = flight.core._backend._current
    assert flight.run(60.0, lambda: bool(statuses(flight, "departed")))
    # The highest number of the plan's own, of the mission before it: the plan's first numbers come after it.
    late = replace(before, seq=flight.core._backend.layout.end - 1)
    for _ in range(4):
        flight.put(replace(late, time_s=flight.telemetry.now_s, link_s=flight.link_s))
        flight.run(0.5)
    flight.run(20.0)
    assert not flight.found((Yield, ExternalControl))


def yielded(flight, within_s):
    """Return the reason of a yield that comes in time, and after which nothing more is sent."""
    assert flight.run(within_s, lambda: bool(flight.found(Yield)))
    sent = len(flight.found(SendMessage))
    flight.run(20.0)
    assert len(flight.found(SendMessage)) == sent
    return flight.found(Yield)[0].reason


def store(mission, items):
    """Store a mission as another station's upload would."""
    index = mission.index
    mission.begin(len(items))
    for number, item in enumerate(items):
        mission.put(number, item, number == index)
    mission.finish()


def test_a_plan_by_command_counts_with_the_links_delay_and_is_obeyed_at_its_time(in_the_air):
    flight = in_the_air("arduplane", guidance="command", faults=LinkFaults(delay_s=0.5))
    late_s: dict[int, float] = {}  # by the number of the plan

    def arrived(name, fields):
        change = flight.core.controller.changes.under_way
        if name == "COMMAND_INT" and change is not None and change.stage == "departing":
            late_s.setdefault(change.command.number, flight.simulation.time_s - change.command.plan.departure_s)

    flight.arrived = arrived
    flight.run(90.0)
    assert len(late_s) >= 4
    assert 1.0 <= flight.core.snapshot().latency_s < 1.4
    assert max(abs(one) for one in list(late_s.values())[1:]) < 0.3  # before the first nothing was measured


@pytest.mark.parametrize(
    ("flavour", "guidance"), [("arduplane", "mission"), ("px4", "mission"), ("arduplane", "command")]
)
def test_another_mode_is_another_station(in_the_air, flavour, guidance):
    flight = in_the_air(flavour, faults=BAD, guidance=guidance)
    flight.run(20.0)
    flight.simulation.pilot_takes_over()
    assert "flight mode" in yielded(flight, 5.0)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_another_stations_mission_is_another_station(in_the_air, flavour):
    flight = in_the_air(flavour, faults=BAD)
    flight.run(20.0)
    items = flight.autopilot.mission.items()
    store(flight.autopilot.mission, [*items, items[-1]])
    assert "another station" in yielded(flight, 15.0)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_another_station_goes_back_in_our_own_line(in_the_air, flavour):
    flight = in_the_air(flavour, faults=BAD)

    def passed() -> int:
        layout = flight.core._backend.layout
        return flight.autopilot.mission.index - layout.first if flight.autopilot.mission.index in layout else 0

    assert flight.run(120.0, lambda: passed() >= 2)
    flight.run(0.5)
    flight.autopilot.set_current_item(flight.core._backend.line_first)
    assert "another station has chosen item" in yielded(flight, 6.0)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_another_station_that_skips_waypoints_of_our_line_is_reported(in_the_air, flavour):
    flight = in_the_air(flavour, faults=BAD)

    def skips():
        return [one for one in flight.found(Announce) if "another station has chosen item" in one.text]

    def begun() -> bool:
        layout, here = flight.core._backend.layout, flight.autopilot.here
        if layout.end - layout.first < 4 or flight.autopilot.mission.index != layout.first:
            return False
        last = layout.items[layout.end - 2]
        east_m, north_m = flight.telemetry.plane.east_north_m(last.x * 1e-7, last.y * 1e-7)
        return math.hypot(east_m - here.east_m, north_m - here.north_m) > 180.0

    assert flight.run(600.0, lambda: begun() and flight.core._backend._change is None)
    assert not skips()
    flight.autopilot.set_current_item(flight.core._backend.layout.end - 1)
    assert flight.run(3.0, lambda: bool(skips()))


def stop(flight, seconds, buffered):
    """Stop the program; what comes in the meantime waits, as far as the socket's buffer holds it."""
    waiting, end_s = [], flight.simulated.time_s + seconds
    while flight.simulated.time_s < end_s:
        flight.simulated.advance(flight.simulated.time_s + flight.simulated.tick_s)
        waiting += flight.simulated.take()[: max(0, buffered - len(waiting))]
    flight.expire()
    for message in flight.simulated.messages(waiting, flight.link_s):
        flight.on_message(message)


@pytest.mark.parametrize(("flavour", "seed"), [("arduplane", 5), ("px4", 2)])
def test_a_stop_of_the_program_is_no_other_station(in_the_air, flavour, seed):
    flight = in_the_air(flavour, seed=seed)
    for number in range(12):
        flight.run(5.0 + (seed * 7 + number * 3.7) % 13)
        stop(flight, (3.0, 20.0, 60.0)[number // 4], (0, 60, 300, 2000)[number % 4])
        flight.run(15.0)
    assert not [one for one in flight.found(Announce) if "another station" in one.text]
    assert not flight.found(Yield)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_arming_that_is_in_progress_indefinitely_is_given_up_and_disarmed(fly, flavour):
    flight = fly(flavour, begin=False)
    on_message, lowered = flight.vehicle.take, mavlink.MAV_RESULT_IN_PROGRESS

    def take(message):
        if message.name == "COMMAND_ACK":
            message.fields["result"] = lowered
        on_message(message)

    flight.vehicle.take = take
    flight.take_over()
    assert flight.run(90.0, lambda: flight.found(TakeoverFailed))
    (failed,) = flight.found(TakeoverFailed)
    assert "did not arm (in progress)" in failed.reason
    assert not flight.autopilot.armed


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_first_mission_that_is_not_taken_is_not_on_board(fly, flavour):
    flight = fly(flavour, begin=False)
    handle = flight.autopilot.handle
    flight.autopilot.handle = lambda station, message: (
        None if message.get_type() == "MISSION_ITEM_INT" else handle(station, message)
    )
    flight.take_over()
    assert flight.run(120.0, lambda: flight.found(TakeoverFailed))
    assert "nothing was commanded" in flight.found(TakeoverFailed)[0].reason
    assert not flight.core.loaded


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_the_failed_checks_are_asked_for_when_arming_is_refused(fly, flavour):
    flight = fly(flavour, begin=False)
    flight.autopilot.__class__ = type("Unready", (type(flight.autopilot),), {"ready": False})
    flight.take_over()
    assert flight.run(20.0, lambda: flight.vehicle.texts.warnings(0.0))
    flight.run(3.0)
    texts = flight.vehicle.texts.warnings(0.0)
    assert flight.autopilot.preflight_failure.strip() in texts
    assert flight.autopilot.arming_refusal[1].strip() in texts
    asked = [one for one in flight.found(SendMessage) if dict(one.fields).get("command") == 401]
    assert len(asked) == 1


def test_an_upload_under_way_stops_with_the_mode_change(in_the_air):
    flight = in_the_air("arduplane")
    loiter, changed_s = 12, []

    def arrived(name, _fields):
        if name == "MISSION_ITEM_INT" and not changed_s:
            changed_s.append(flight.telemetry.now_s)
            flight.autopilot.set_mode(loiter)

    flight.arrived = arrived
    assert "LOITER" in yielded(flight, 60.0)
    assert flight.found(SendMessage)[-1].time_s < changed_s[0] + 2.0


def test_the_autopilot_starts_again(in_the_air):
    flight = in_the_air("px4")
    flight.run(20.0)
    flight.simulation.reboot()
    assert yielded(flight, 10.0)  # by its mode, or by its clock: whichever is received first


def test_another_station_moves_the_circle(in_the_air):
    flight = in_the_air("arduplane", guidance="command", faults=BAD)
    assert flight.run(60.0, lambda: statuses(flight, "departed") and flight.core._backend._flown is None)
    here = flight.autopilot.here
    flight.autopilot._circle_at(type(here)(here.east_m - 500.0, here.north_m, 100.0), True)
    assert "moved the circle" in yielded(flight, 10.0)


def test_answers_to_another_station_are_not_ours(in_the_air):
    """Another ground station reads the mission, and is refused a command, all the time."""
    flight = in_the_air("arduplane")
    flight.simulation.connect("other")
    for _ in range(40):
        flight.to_vehicle("MISSION_REQUEST_LIST", source=(250, 190))
        flight.to_vehicle("COMMAND_LONG", source=(250, 190), command=31_000)
        flight.run(1.0)
    assert len(statuses(flight, "departed")) >= 2
    assert not flight.found(Yield)


def doubtful(flight):
    """Let an upload end without an answer: neither its acknowledgement nor the list on board comes through."""
    flight.lost = {"MISSION_ACK", "MISSION_COUNT"}
    before = len(statuses(flight, "failed"))
    assert flight.run(60.0, lambda: len(statuses(flight, "failed")) > before)


def test_a_mission_whose_upload_ended_in_doubt_is_read_before_it_is_taken_for_ours(in_the_air):
    flight = in_the_air("px4")
    flight.run(20.0)
    doubtful(flight)
    flight.run(5.0)
    uploads = [one for one in flight.found(SendMessage) if one.name == "MISSION_ITEM_INT"]
    flight.run(5.0)
    assert len([one for one in flight.found(SendMessage) if one.name == "MISSION_ITEM_INT"]) == len(uploads)
    flight.lost = set()
    departed = len(statuses(flight, "departed"))
    assert flight.run(60.0, lambda: len(statuses(flight, "departed")) > departed)
    assert not flight.found(Yield)


def test_a_foreign_mission_of_the_length_of_one_in_doubt_is_not_taken_for_ours(in_the_air):
    flight = in_the_air("px4")
    flight.run(20.0)
    doubtful(flight)
    mission = flight.autopilot.mission
    store(mission, [replace(item, latitude_e7=item.latitude_e7 + 9_000) for item in mission.items()])
    flight.lost = set()
    assert yielded(flight, 15.0) == "another station has changed the mission"

"""Missions written to and read from simulated autopilots over links that lose, delay, double and reorder."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.mission.exchange.mission_read import MissionRead
from sidelong.mission.exchange.mission_write import MissionWrite, WriteResult
from sidelong.mission.exchange.outbox import Outbox
from sidelong.mission.exchange.reports import (
    MissionAcknowledged,
    MissionCountReported,
    MissionItemReported,
    MissionItemRequested,
    TimerExpired,
)
from sidelong.mission.upload.mission_item import MissionItem, same_item, same_items
from sidelong.sitl.settings import LinkFaults

ACCEPTED, DENIED, TIMEOUT = WriteResult
QUIRKS = {one.name.lower(): one.quirks for one in AUTOPILOTS}
COUNT, CHANGED = 24, range(5, 12)
DELAY_S = 0.025


def circle(tag):
    return MissionItem(17, 6, 0.0, 0.0, 60.0 + tag % 20, 0.0, 470_000_000 + tag, 80_000_000 - tag, 100.0)


OLD = tuple(circle(seq) for seq in range(COUNT))
NEW = tuple(circle(1000 + seq) if seq in CHANGED else OLD[seq] for seq in range(COUNT))


class Work:
    """A write or a read in the place of the core."""

    def __init__(self, flight, make):
        self._outbox = Outbox()
        self._outbox.begin(0.0, flight.link_s)
        self._work = make(self._outbox)

    @property
    def next_timer_s(self):
        return self._work.next_timer_s

    @property
    def over(self):
        return self._work.done if isinstance(self._work, MissionRead) else self._work.result is not None

    def step(self, event):
        self._outbox.begin(event.time_s, getattr(event, "link_s", self._outbox.link_s))
        if isinstance(event, TimerExpired):
            self._work.expire()
        else:
            self._work.receive(event)
        sent = tuple(self._outbox.sent)
        self._outbox.sent.clear()
        return sent


@pytest.fixture
def transfer(fly):
    """Return what lets one piece of work after the other at a vehicle, the first over a clean link."""

    def run(flavour, faults, seed, *makes):
        flight = fly(flavour, seed=seed, begin=False)
        done = []
        for number, make in enumerate(makes):
            flight.spoil(faults if number else LinkFaults(delay_s=0.002))
            flight.core = Work(flight, lambda outbox, make=make: make(outbox, QUIRKS[flavour], flight.link_s))
            begin_s = flight.link_s
            flight.put(TimerExpired(0.0, flight.link_s))
            assert flight.run(60.0, lambda: flight.core.over)
            took_s = flight.link_s - begin_s
            done.append(flight.core._work)
            flight.run(0.5)
        return done, flight.autopilot.mission.items(), took_s

    return run


def write(items, changed, bound_s=20.0):
    return lambda outbox, quirks, now_s: MissionWrite(outbox, quirks, items, changed, now_s + bound_s, lambda: 0)


WHOLE = write(OLD, range(COUNT))


@pytest.mark.parametrize("loss", [0.0, 0.05, 0.2, 0.5])
def test_a_part_is_written_and_the_rest_is_left_alone(transfer, raw_items, loss):
    took_s = []
    for seed in range(3):
        faults = LinkFaults(loss, 0.1 if loss else 0.0, DELAY_S, DELAY_S if loss else 0.0)
        done, items, seconds = transfer("arduplane", faults, seed, WHOLE, write(NEW, CHANGED))
        assert [one.result for one in done] == [ACCEPTED, ACCEPTED]
        assert all(map(same_item, raw_items(items)[1:], NEW[1:]))
        took_s.append(seconds)
    assert sorted(took_s)[1] < {0.0: 0.35, 0.05: 1.5, 0.2: 3.0, 0.5: 20.0}[loss]  # of the link's clock


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_px4_takes_a_list_whole_and_reports_which(transfer, raw_items, loss):
    took_s = []
    for seed in range(9 if loss else 1):  # one draw of losses means little: now and then one takes ten seconds
        faults = LinkFaults(loss, 0.1 if loss else 0.0, DELAY_S)
        done, items, seconds = transfer("px4", faults, seed, WHOLE, write(NEW, range(COUNT)))
        assert [one.result for one in done] == [ACCEPTED, ACCEPTED]
        assert same_items(NEW, raw_items(items))
        assert done[1].mission_id not in (0, done[0].mission_id) or loss
        took_s.append(seconds)
    assert sorted(took_s)[len(took_s) // 2] < (0.3 if loss == 0.0 else 4.0)  # of the link's clock


def test_cut_at_any_moment_each_item_is_the_old_or_the_new_one_and_a_second_try_ends_it(transfer, raw_items):
    for hundredths in range(4, 40, 9):
        faults = LinkFaults(0.2, 0.0, DELAY_S)
        cut = write(NEW, CHANGED, hundredths / 100.0)
        done, items, _ = transfer("arduplane", faults, hundredths, WHOLE, cut, write(NEW, CHANGED))
        assert done[1].result in (ACCEPTED, TIMEOUT)
        assert len(items) == COUNT
        assert done[2].result is ACCEPTED
        assert all(map(same_item, raw_items(items)[1:], NEW[1:]))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_an_item_that_the_vehicle_refuses_is_a_refusal(transfer, raw_items, flavour):
    bad = (*NEW[:6], replace(NEW[6], command=31_000), *NEW[7:])
    changed = CHANGED if flavour == "arduplane" else range(COUNT)
    done, items, _ = transfer(flavour, LinkFaults(), 1, WHOLE, write(bad, changed))
    assert done[1].result is DENIED
    assert all(map(same_item, raw_items(items)[7:], OLD[7:]))


def test_places_that_the_vehicle_does_not_have_are_a_refusal(transfer):
    longer = (*OLD, *(circle(500 + seq) for seq in range(6)))
    done, items, _ = transfer("arduplane", LinkFaults(), 1, WHOLE, write(longer, range(COUNT, COUNT + 6), 8.0))
    assert done[1].result in (DENIED, TIMEOUT)
    assert len(items) <= COUNT + 1


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_the_mission_is_read_as_it_is_on_board(transfer, flavour, loss):
    def read(outbox, quirks, now_s):
        return MissionRead(outbox, quirks, now_s + 40.0)

    done, _, took_s = transfer(flavour, LinkFaults(loss, 0.0, DELAY_S), 5, WHOLE, read)
    assert all(map(same_item, done[1].items[1:], OLD[1:]))
    at_once = QUIRKS[flavour].stores_items_one_by_one
    assert took_s < {0.0: 0.35 if at_once else 3.0, 0.3: 3.0 if at_once else 40.0}[loss]  # of the link's clock


@pytest.mark.parametrize(("loss", "most_s"), [(0.0, 1.5), (0.05, 4.0)])
def test_px4_is_read_in_two_round_trips_where_nothing_is_lost(transfer, loss, most_s):
    def read(outbox, quirks, now_s):
        return MissionRead(outbox, quirks, now_s + 40.0)

    took_s = []
    for seed in range(5):
        done, _, seconds = transfer("px4", LinkFaults(loss, delay_s=0.3), seed, WHOLE, read)
        assert same_items(OLD, done[1].items)
        took_s.append(seconds)
    assert sorted(took_s)[2] < most_s  # of the link's clock; one item after the other took 15 s


def test_requests_that_overtake_each_other_are_sent_one_after_the_other(transfer):
    def read(outbox, quirks, now_s):
        return MissionRead(outbox, quirks, now_s + 40.0)

    done, _, _ = transfer("px4", LinkFaults(delay_s=0.02, jitter_s=0.1), 3, WHOLE, read)
    assert same_items(OLD, done[1].items)


def test_a_reading_without_answer_is_called_off():
    outbox = Outbox(0.0, 0.0)
    read = MissionRead(outbox, QUIRKS["px4"], 5.0)
    outbox.begin(0.0, 5.0)
    read.expire()
    assert read.done
    assert outbox.sent[-1].name == "MISSION_ACK"


def test_late_answers_to_the_upload_before_say_nothing():
    outbox = Outbox(0.0, 0.0)
    late = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, mission_ids_before={77})
    late.receive(MissionAcknowledged(0.0, 0.1, 0, 77))
    late.receive(MissionItemRequested(0.0, 0.2, COUNT - 1))
    late.receive(MissionAcknowledged(0.0, 0.3, 0, 77))
    assert late.result is None
    late.receive(MissionAcknowledged(0.0, 0.4, 0, 78))
    assert late.result is ACCEPTED
    assert late.mission_id == 78


def reported(items, mission_id):
    """Return the vehicle's answers to who reads its list."""
    count = MissionCountReported(0.0, 0.5, len(items), mission_id)
    return [count, *(MissionItemReported(0.0, 0.6, seq, item) for seq, item in enumerate(items))]


@pytest.mark.parametrize(
    ("requested", "doubt_before", "silent_s"),
    [(COUNT - 1, True, 0.1), (COUNT - 2, False, 5.0)],
    ids=["one in doubt before", "a part of it"],
)
def test_what_may_be_another_acknowledgement_is_accepted_only_by_the_items_on_board(
    requested, doubt_before, silent_s
):
    outbox = Outbox(0.0, 0.0)
    upload = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, {77}, doubt_before)
    upload.receive(MissionItemRequested(0.0, -silent_s, requested))
    upload.receive(MissionAcknowledged(0.0, 0.0, 0, 78))
    assert upload.result is None
    for report in reported(OLD, 78):
        upload.receive(report)
    assert upload.result is None  # begun again
    upload.receive(MissionItemRequested(0.0, 0.7, requested))
    upload.receive(MissionAcknowledged(0.0, 0.7 + silent_s, 0, 79))
    for report in reported(NEW, 79):
        upload.receive(report)
    assert upload.result is ACCEPTED
    assert upload.mission_id == 79


def test_a_vehicle_that_asks_for_items_still_has_not_acknowledged_them():
    outbox = Outbox(0.0, 0.0)
    upload = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, doubt_before=True)
    upload.receive(MissionItemRequested(0.0, 0.2, 3))
    upload.receive(MissionAcknowledged(0.0, 0.3, 0, 78))
    upload.receive(MissionItemRequested(0.0, 0.4, 4))
    outbox.sent.clear()
    outbox.begin(0.0, upload.next_timer_s)
    upload.expire()
    sent = [one.fields["seq"] for one in outbox.sent if one.name == "MISSION_ITEM_INT"]
    assert sent == [seq for seq in range(4, COUNT) for _ in range(2)]  # one was lost: from now on each twice


def test_all_behind_an_item_that_is_asked_for_again_is_sent_again():
    """PX4 leaves alone what comes behind a lost item, and asks for that one every 0.25 s."""
    outbox = Outbox(0.0, 0.0)
    upload = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0)
    for time_s, seq in ((0.1, 0), (0.2, 1), (0.2, 2), (0.2, 3)):
        upload.receive(MissionItemRequested(0.0, time_s, seq))
    outbox.begin(0.0, 0.4)
    for at_once in (True, False):  # a request that was doubled on its way costs no more than the item
        outbox.sent.clear()
        upload.receive(MissionItemRequested(0.0, 0.4, 3))
        sent = [one.fields["seq"] for one in outbox.sent]
        assert sent == ([seq for seq in range(3, COUNT) for _ in range(2)] if at_once else [3])


def test_an_acknowledgement_is_of_all_items_where_their_last_requests_were_lost():
    upload = MissionWrite(Outbox(0.0, 0.0), QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, {77})
    upload.receive(MissionItemRequested(0.0, 0.2, COUNT - 3))
    upload.receive(MissionAcknowledged(0.0, 0.3, 0, 78))
    assert upload.result is ACCEPTED


def test_the_answer_to_the_last_item_reports_that_all_is_there_where_another_one_is_refused():
    """The last requests and the acknowledgement were lost; what is sent again is an error but for the last item."""
    outbox = Outbox(0.0, 0.0)
    upload = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, {77})
    upload.receive(MissionItemRequested(0.0, 0.05, COUNT - 2))
    outbox.begin(0.0, upload.next_timer_s)
    upload.expire()
    outbox.sent.clear()
    for result in (1, 1, 0):
        upload.receive(MissionAcknowledged(0.0, outbox.link_s + 0.05, result, 78))
    assert upload.result is ACCEPTED
    assert not outbox.sent


def test_px4_that_receives_nothing_is_read():
    """No answer to the last item follows: the list reports whether all is there."""
    outbox = Outbox(0.0, 0.0)
    upload = MissionWrite(outbox, QUIRKS["px4"], NEW, range(COUNT), 8.0, lambda: 0, {77})
    upload.receive(MissionItemRequested(0.0, 0.05, COUNT - 2))
    upload.receive(MissionAcknowledged(0.0, 0.1, 1, 0))
    outbox.begin(0.0, upload.next_timer_s)
    upload.expire()
    assert outbox.sent[-1].name == "MISSION_REQUEST_LIST"
    for report in reported(NEW, 78):
        upload.receive(report)
    assert upload.result is ACCEPTED


def test_px4_acknowledges_a_part_after_an_outage_and_is_not_accepted(fly, raw_items):
    """It gives an upload up after 5 s of silence, and acknowledges the item that came last when that comes again."""
    flight = fly("px4", faults=LinkFaults(delay_s=0.025), begin=False)
    put, on_message, received, end_s = flight.transmit, flight.on_message, 7, flight.link_s + 6.0

    def put_some(frame):
        if flight.link_s > end_s or flight.sent[frame][1].get("seq", 0) <= received:
            put(frame)

    def receive_some(message):
        asked_for_more = message.name == "MISSION_REQUEST_INT" and message.fields["seq"] > received
        if flight.link_s > end_s or not asked_for_more:
            on_message(message)

    flight.transmit, flight.on_message = put_some, receive_some
    flight.core = Work(flight, lambda outbox: write(NEW, range(COUNT), 30.0)(outbox, QUIRKS["px4"], flight.link_s))
    flight.put(TimerExpired(0.0, flight.link_s))
    flight.run(0.3)
    flight.transmit = lambda frame: put(frame) if flight.link_s > end_s else None
    assert flight.run(25.0, lambda: flight.core.over)
    assert flight.core._work.result is ACCEPTED
    assert same_items(NEW, raw_items(flight.autopilot.mission.items()))

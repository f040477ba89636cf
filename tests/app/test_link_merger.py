"""Several links made one: nothing twice, nothing back in time, and the better link used. And how good a link is."""

from __future__ import annotations

import itertools
import random

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.quality import LinkQuality, Measured
from sidelong.app.link.raw_links import LinkMerger, time_of
from tests.messages import Sender


def position(time_s):
    return mavlink.MAVLink_global_position_int_message(round(1e3 * time_s), *(0,) * 8)


def mode(number):
    return mavlink.MAVLink_heartbeat_message(1, 3, 81, number, 4, 3)


def laser(time_s, sensor=1):
    return mavlink.MAVLink_distance_sensor_message(round(1e3 * time_s), 10, 9000, 3000, 0, sensor, 0, 0)


def test_a_single_link_passes_everything():
    merger, sender = LinkMerger(1), Sender()
    assert all(merger.passes(0, sender(position(time_s)), time_s) for time_s in (1.0, 1.0, 0.5))


def test_positions_of_two_links_never_go_back_in_time_and_fill_each_other_s_gaps():
    rng = random.Random(1)
    merger, senders = LinkMerger(2), (Sender(), Sender())
    arriving = []  # the second link is 220 ms later, its samples fall between the first one's, both lose a third
    for tick in range(3000):
        for link, (delay_s, phase_s) in enumerate(((0.03, 0.0), (0.25, 0.05))):
            time_s = 10.0 + 0.1 * tick + phase_s
            if rng.random() > 0.33:
                arriving.append((time_s + delay_s, link, time_s))
    passed, alone_s = [], [0.0, 0.0]
    for now_s, link, time_s in sorted(arriving):
        if merger.passes(link, senders[link](position(time_s)), now_s):
            passed.append(time_s)
            alone_s[link] += 1
    assert passed == sorted(set(passed))
    assert alone_s[1] > 20  # of the slower link, where the first had a gap
    assert max(b - a for a, b in itertools.pairwise(passed)) < 1.0


def flown(stray=None, silent_from_s=None):
    """Return the times that pass of two links at 10 Hz, link 1 with a stray stamp at 20 s or silent later on."""
    merger, senders = LinkMerger(2), (Sender(), Sender())
    passed = []
    for tick in range(600):
        now_s = 10.0 + 0.1 * tick
        for link in (0, 1):
            if link == 1 and silent_from_s is not None and now_s >= silent_from_s:
                continue
            time_s = stray if link == 1 and stray is not None and tick == 100 else now_s + 0.02 * link
            if merger.passes(link, senders[link](position(time_s)), now_s):
                passed.append(time_s)
    return passed


@pytest.mark.parametrize("stray", [3600.0, 1.0])
def test_one_stray_stamp_on_one_link_holds_back_neither_link(stray):
    passed = flown(stray=stray, silent_from_s=20.1)
    good = [time_s for time_s in passed if time_s < 100.0]
    assert max(b - a for a, b in itertools.pairwise(sorted(good))) < 3.0
    assert good[-1] > 69.0
    assert 3600.0 not in passed


def test_clock_that_really_has_jumped_is_followed_once_the_old_one_is_silent():
    merger, senders = LinkMerger(2), (Sender(), Sender())
    passed = []
    for tick in range(200):
        now_s = 10.0 + 0.1 * tick
        time_s = now_s + (3600.0 if tick >= 100 else 0.0)
        for link in (0, 1):
            if merger.passes(link, senders[link](position(time_s)), now_s):
                passed.append((now_s, time_s))
    jumped = [now_s for now_s, time_s in passed if time_s > 3000.0]
    assert jumped[0] == pytest.approx(22.0, abs=0.3)
    assert len(jumped) > 60


def test_the_mode_is_accepted_of_the_link_in_use_only():
    merger, first, second = LinkMerger(2), Sender(), Sender()
    assert merger.passes(0, first(mode(10)), 0.0)
    assert merger.passes(0, first(mode(11)), 1.0)
    assert not merger.passes(1, second(mode(10)), 1.2)  # older than it looks: this link is slow


def test_after_a_change_a_slow_link_is_accepted_once_it_has_caught_up():
    merger, first, second = LinkMerger(2), Sender(), Sender()
    for time_s in (1.0, 1.1, 1.2):
        assert merger.passes(0, first(position(time_s)), time_s)
    merger.passes(1, second(position(1.05)), 1.3)
    silent, good = measured(silent_s=1.5), measured()
    assert merger.choose([silent, good], 2.8)
    assert merger.in_use == 1
    assert not merger.passes(1, second(position(1.15)), 2.8)
    assert not merger.passes(1, second(mode(10)), 2.8)
    assert merger.passes(1, second(position(1.3)), 2.9)
    assert merger.passes(1, second(mode(11)), 2.9)


def test_a_vehicle_that_starts_again_is_received():
    merger, first, second = LinkMerger(2), Sender(), Sender()
    assert merger.passes(0, first(position(500.0)), 0.0)
    assert not merger.passes(1, second(position(499.0)), 0.1)
    assert merger.passes(0, first(position(1.0)), 2.0)
    assert merger.passes(0, first(position(1.1)), 2.1)


def test_a_sensor_s_message_that_comes_by_both_links_is_passed_once():
    merger, first, second = LinkMerger(2), Sender(154), Sender(154)
    for number in range(100):
        message = laser(0.1 * number)
        assert merger.passes(number % 2, (first, second)[number % 2](message), 0.1 * number)
        assert not merger.passes(1 - number % 2, (second, first)[number % 2](message), 0.1 * number + 0.8)
    # two sensors of one component that measure at the same time are two
    assert merger.passes(0, first(laser(50.0, 1)), 50.0)
    assert merger.passes(0, first(laser(50.0, 2)), 50.0)


def test_the_same_answer_twice_on_one_link_is_two_answers():
    merger, first, second = LinkMerger(2), Sender(), Sender()
    answer = mavlink.MAVLink_command_ack_message(511, 0)
    assert merger.passes(0, first(answer), 0.0)
    assert not merger.passes(1, second(answer), 0.1)
    assert merger.passes(0, first(answer), 0.2)
    assert not merger.passes(1, second(answer), 0.3)
    assert merger.passes(1, second(answer), 2.0)


def test_what_is_remembered_is_bounded():
    merger, sender = LinkMerger(2), Sender(154)
    for number in range(20_000):
        assert merger.passes(0, sender(laser(0.01 * number)), 0.01 * number)
    assert len(merger._passed) < 6000


def measured(silent_s=0.05, loss=0.0, round_trip_s=0.1, received_bytes_s=2000.0, unanswered_s=0.5):
    return Measured(silent_s, loss, round_trip_s, received_bytes_s, 100.0, unanswered_s=unanswered_s)


@pytest.mark.parametrize(
    ("present", "other", "changes_after_s"),
    [
        (measured(), measured(), None),
        (measured(silent_s=0.9), measured(), None),
        (measured(silent_s=1.1), measured(), 0.0),
        (measured(silent_s=1.1), measured(silent_s=1.0), None),  # both are silent
        (measured(silent_s=1.1, received_bytes_s=50.0), measured(), None),  # one that seldom speaks
        (measured(silent_s=3.6, received_bytes_s=50.0), measured(), 0.0),
        (measured(loss=0.1), measured(), None),
        (measured(loss=0.3), measured(), 3.0),
        (measured(round_trip_s=0.6), measured(), 3.0),
        (measured(unanswered_s=2.9), measured(), None),
        (measured(unanswered_s=3.5), measured(), 3.0),  # it is received, and receives nothing of ours
        (measured(unanswered_s=60.0), measured(unanswered_s=60.0), None),
    ],
)
def test_the_link_in_use_is_left_when_it_is_silent_or_clearly_worse(present, other, changes_after_s):
    merger, now_s = LinkMerger(2), 100.0
    for link in range(2):
        merger.passes(link, Sender()(mode(10)), now_s)
    while not merger.choose([present, other], now_s) and now_s < 120.0:
        now_s += 0.1
    assert (None if now_s >= 120.0 else round(now_s - 100.0, 0)) == changes_after_s


def test_a_payload_s_own_link_is_not_spoken_on():
    merger, payload, vehicle = LinkMerger(2), Sender(154), Sender()
    assert merger.passes(1, payload(laser(1.0)), 1.0)
    assert merger.passes(0, vehicle(mode(10)), 1.1)
    assert merger.in_use == 0
    assert not merger.choose([measured(silent_s=1.5), measured()], 2.6)


def test_every_message_with_a_time_reports_it():
    sender = Sender()
    assert time_of(sender(position(12.5))) == 12.5
    assert time_of(sender(mavlink.MAVLink_attitude_message(3000, *(0.0,) * 6))) == 3.0
    assert time_of(sender(mavlink.MAVLink_wind_cov_message(7_000_000, *(0.0,) * 8))) == 7.0
    assert time_of(sender(mode(1))) is None


# -- quality ------------------------------------------------------------------------------------------------------


def test_loss_is_counted_by_sequence_numbers_of_each_source():
    rng, quality, lost = random.Random(2), LinkQuality(0.0), 0
    for number in range(10_000):
        for source in ((1, 1), (1, 154)):
            if rng.random() < 0.2 and number:
                lost += 1
            else:
                quality.frame(source, number & 0xFF, 40, 0.001 * number)
    assert quality.total(10.0).loss == pytest.approx(lost / 20_000, abs=1e-3)
    assert quality.measured(10.0).loss == pytest.approx(0.2, abs=0.02)
    assert quality.measured(10.0).received_bytes_s == pytest.approx(0.8 * 2 * 40 * 1000, rel=0.05)


def test_doubled_and_late_frames_are_no_loss():
    quality = LinkQuality(0.0)
    for number in (0, 1, 1, 2, 4, 3, 5, 6):
        quality.frame((1, 1), number, 40, 0.1 * number)
    assert quality.whole.received == 6
    assert quality.whole.missed == 1


def test_delay_is_the_median_and_silence_is_since_the_last_frame():
    quality = LinkQuality(0.0)
    assert quality.measured(5.0) == Measured(5.0, None, None, 0.0, 0.0)
    for round_trip_s in (0.1, 0.1, 3.0):
        quality.answered(round_trip_s, 6.0)
    quality.frame((1, 1), 0, 40, 6.0)
    assert quality.measured(6.5).round_trip_s == 0.1
    assert quality.measured(6.5).silent_s == 0.5


def test_questions_without_an_answer_are_noticed():
    quality = LinkQuality(0.0)
    assert quality.measured(5.0).unanswered_s == 0.0  # nothing was asked
    for second in range(5, 10):
        quality.asked(float(second))
    assert quality.measured(9.0).unanswered_s == 4.0
    quality.answered(0.1, 9.5)
    quality.asked(10.0)
    assert quality.measured(10.5).unanswered_s == 1.0

"""A bad link loses, delays and doubles what it is given, each in its measure."""

import numpy as np
import pytest

from sidelong.sitl.server import FaultyLink
from sidelong.sitl.settings import LinkFaults


def through(faults, count=20_000, seed=1):
    link = FaultyLink(faults, np.random.default_rng(seed))
    out = []
    for i in range(count):
        link.put(i, 0.01 * i)
        out += [(0.01 * i, item) for item in link.take(0.01 * i)]
    return out


def test_a_good_link_passes_everything_at_once_and_in_order():
    assert [item for _, item in through(LinkFaults(), 100)] == list(range(100))


def test_the_fraction_lost_is_the_fraction_asked_for():
    assert len(through(LinkFaults(loss=0.2))) == pytest.approx(16_000, rel=0.03)


def test_the_fraction_doubled_is_the_fraction_asked_for():
    assert len(through(LinkFaults(duplicate=0.1))) == pytest.approx(22_000, rel=0.03)


def test_everything_comes_late_by_the_delay():
    out = through(LinkFaults(delay_s=0.05), 100)
    assert all(now_s - 0.01 * item == pytest.approx(0.05, abs=0.011) for now_s, item in out)
    assert [item for _, item in out] == sorted(item for _, item in out)


def test_a_serial_line_carries_what_its_rate_allows_and_loses_what_finds_no_room():
    link = FaultyLink(LinkFaults(baud=57_600), np.random.default_rng(1))
    for number in range(100):
        link.put(number, 0.0, 100)
    assert link.take(0.0) == []
    assert link.take(0.18) == list(range(10))
    assert link.take(10.0) == list(range(10, 41))
    link.put("later", 10.0, 57)
    assert link.take(10.01) == ["later"]


def test_it_reports_when_the_next_is_due():
    link = FaultyLink(LinkFaults(delay_s=0.5), np.random.default_rng(1))
    assert link.next_s == float("inf")
    link.put("a", 1.0)
    assert link.next_s == 1.5

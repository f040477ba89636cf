from __future__ import annotations

import pytest

from sidelong.app.commands.payload import payload_lines
from sidelong.app.payload.driver import RangeMeasured
from sidelong.sitl.payload.devices import DEVICES
from sidelong.sitl.settings import Quirks
from tests.payload.wiring import Wired, looking

SEES = looking(300.0, bearing_deg=-70.0, elevation_deg=-21.0)


@pytest.mark.parametrize("kind", DEVICES)
def test_payload_unplugged_ten_times_is_reported_and_read_again_within_three_seconds(kind):
    wired = Wired(kind, delay_s=0.02)
    wired.run(10.0, SEES)
    for time in range(10):
        wired.reports.clear()
        wired.plugged = False
        wired.run(5.0 + 0.3 * time, SEES)
        if time % 2:
            wired.restart_device()
        wired.plugged = True
        back_s = wired.now_s
        measured = wired.run(5.0, SEES)
        texts = [text for _, text in wired.reports]
        assert sum("no data" in text for text in texts) == 1
        assert sum("data again" in text for text in texts) == 1
        assert not [text for text in texts if "no range" in text]
        first_s = next(one.time_s for one in measured if isinstance(one, RangeMeasured))
        assert first_s - back_s < 3.0


@pytest.mark.parametrize("kind", DEVICES)
def test_payload_that_never_answers_is_reported_once(kind):
    wired = Wired(kind)
    wired.plugged = False
    wired.run(60.0, SEES)
    assert ["no data" in text for _, text in wired.reports] == [True]
    assert "it does not answer" in wired.session.status(wired.now_s).missing[0]


@pytest.mark.parametrize("kind", DEVICES)
def test_target_beyond_reach_leaves_angles_and_is_reported(kind):
    wired = Wired(kind, Quirks(reach_m=250.0))
    measured = wired.run(15.0, SEES)
    assert measured
    assert not [one for one in measured if isinstance(one, RangeMeasured)]
    assert sum("no range" in text for _, text in wired.reports) == 1
    assert any("no range" in text for text in wired.session.status(wired.now_s).missing)
    assert [one for one in wired.run(2.0, looking(200.0, 0.0, -30.0)) if isinstance(one, RangeMeasured)]
    assert any("ranges again" in text for _, text in wired.reports)


@pytest.mark.parametrize("kind", DEVICES)
def test_damaged_frames_cost_their_measurements_and_nothing_else(kind):
    wired = Wired(kind, Quirks(damaged=0.2))
    measured = wired.run(20.0, SEES)
    ranges = [one.slant_range_m for one in measured if isinstance(one, RangeMeasured)]
    assert len(ranges) > 100
    assert wired.driver.damaged > 15
    assert not [text for _, text in wired.reports if "no data" in text]


def test_pause_of_this_program_is_not_reported_as_loss():
    wired = Wired("siyi")
    wired.run(5.0, SEES)
    wired.reports.clear()
    wired._steps += 500  # five seconds in which nothing was called
    wired.run(5.0, SEES)
    assert wired.reports == []


def test_status_reports_rates_and_model():
    wired = Wired("siyi", delay_s=0.03)
    wired.run(10.0, SEES)
    status = wired.session.status(wired.now_s)
    assert status.identity.model == "ZT30"
    assert status.range_hz == pytest.approx(10.0, abs=1.0)
    assert status.angles_hz == pytest.approx(20.0, abs=2.0)
    assert status.round_trip_s == pytest.approx(0.06, abs=0.011)
    assert status.missing == ()


def test_bytes_of_another_protocol_or_baud_rate_are_not_reported_as_silence():
    wired = Wired("siyi")
    wired.plugged = False
    for _ in range(500):
        wired.step(SEES(wired.now_s))
        wired.session.receive(b"#tpGUCrGIAEC78", wired.now_s)
    words = "bytes arrive, but nothing of its protocol: check its kind and its baud rate"
    assert [text for _, text in wired.reports] == [f"payload siyi: {words}"]
    assert wired.session.status(wired.now_s).missing == (words,)


@pytest.mark.parametrize("kind", DEVICES)
def test_line_that_echoes_our_requests_costs_neither_rate_nor_round_trip(kind):
    wired = Wired(kind, Quirks(streams=False), delay_s=0.02, echoes=True)
    wired.run(20.0, SEES)
    status, models = wired.session.status(wired.now_s), [text for _, text in wired.reports]
    assert status.range_hz == pytest.approx(10.0, abs=1.0)
    assert status.angles_hz >= 9.0
    assert status.round_trip_s == pytest.approx(0.04, abs=0.011)
    assert models == [f"payload {kind}: {status.identity.model}"]


def test_only_what_arrives_now_is_printed_as_of_now():
    wired = Wired("siyi")
    wired.run(5.0, SEES)
    assert any("now: range 300.0 m" in line for line in payload_lines("siyi", wired.session.status(wired.now_s)))
    wired.plugged = False
    wired.run(5.0, SEES)
    assert not [line for line in payload_lines("siyi", wired.session.status(wired.now_s)) if "now:" in line]

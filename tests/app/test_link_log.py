"""A link's bytes a second, by the vehicle's clock, and their file."""

from __future__ import annotations

import asyncio
import math

import pytest

from sidelong.app.flight.recording import ClockRate, link_log
from sidelong.app.link.quality import LinkQuality, LinkReport


def test_bytes_count_by_the_vehicles_seconds_in_a_fast_simulation():
    vehicle_s = -math.inf
    clock_rate = ClockRate(lambda: vehicle_s)
    clock_rate.look(100.0)
    assert clock_rate.mean == 1.0
    for second in range(1, 11):
        vehicle_s = 50.0 + 10.0 * second + (3600.0 if second > 5 else 0.0)  # its clock is set once
        clock_rate.look(100.0 + second)
    assert clock_rate.mean == pytest.approx(10.0)
    quality = LinkQuality(100.0)
    quality.frame((1, 1), 0, 20_000, 105.0)
    quality.sent(1_000, 105.0)
    report = LinkReport("udpin://127.0.0.1:14550", False, True, quality.total(110.0), {})
    values = report.as_json(clock_rate.mean)
    assert (values["received_bytes_s"], values["sent_bytes_s"]) == (pytest.approx(200.0), pytest.approx(10.0))


def test_flight_goes_on_when_the_file_cannot_be_written(tmp_path):
    path, announced, flown = tmp_path / "links.csv", [], []
    path.mkdir()

    async def fly():
        async with link_log(None, path, ClockRate(lambda: 0.0), announced.append):
            flown.append(True)

    asyncio.run(fly())
    assert flown == [True]
    assert [text.endswith("The flight goes on without this record.") for text in announced] == [True]

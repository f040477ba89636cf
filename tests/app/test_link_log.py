"""A link's bytes a second, by the vehicle's clock."""

from __future__ import annotations

import math

import pytest

from app.flight.link_log import Pace
from app.link.quality import LinkQuality, LinkReport


def test_bytes_count_by_the_vehicles_seconds_in_a_fast_simulation():
    vehicle_s = -math.inf
    pace = Pace(lambda: vehicle_s)
    pace.look(100.0)
    assert pace.rate == 1.0
    for second in range(1, 11):
        vehicle_s = 50.0 + 10.0 * second + (3600.0 if second > 5 else 0.0)  # its clock is set once
        pace.look(100.0 + second)
    assert pace.rate == pytest.approx(10.0)
    quality = LinkQuality(100.0)
    quality.frame((1, 1), 0, 20_000, 105.0)
    quality.sent(1_000, 105.0)
    report = LinkReport("udpin://127.0.0.1:14550", False, True, quality.total(110.0), {})
    values = report.as_json(pace.rate)
    assert (values["received_bytes_s"], values["sent_bytes_s"]) == (pytest.approx(200.0), pytest.approx(10.0))

"""How often laser and gimbal speak, counted while other questions to the vehicle are answered."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace

import pytest

from sidelong.app.config import SharingSection
from sidelong.app.flight.source_rates import SourceRates
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import Vehicle


def said(name: str, at_s: float, **fields) -> Message:
    return Message(name, 1, 1, {"time_boot_ms": round(1000.0 * at_s), **fields}, time.time() - 100.0 + at_s)


def attitude(at_s: float) -> Message:
    return said("ATTITUDE", at_s, roll=0.0, pitch=0.0, yaw=0.0, rollspeed=0.0, pitchspeed=0.0, yawspeed=0.0)


def laser(at_s: float) -> Message:
    fields = {"min_distance": 10, "max_distance": 60_000, "current_distance": 25_000, "type": 0, "id": 3}
    return said("DISTANCE_SENSOR", at_s, **fields, orientation=100, covariance=255, signal_quality=90)


def test_what_was_heard_before_counts_and_then_it_begins_anew():
    async def main():
        vehicle = Vehicle(SimpleNamespace(system_id=1, own_id=(245, 190)))
        rates = SourceRates(vehicle)
        for tick in range(90, 100):  # ten seconds of the clock on the wall are over
            vehicle.take(attitude(tick))
            vehicle.take(laser(tick + 0.25))
            vehicle.take(laser(tick + 0.75))
        vehicle.take(attitude(100.0))
        begun_s = time.monotonic()
        first = await rates.heard(1.0, SharingSection())
        at_once = time.monotonic() - begun_s < 1.0
        second = await rates.heard(0.01, SharingSection())
        rates.close()
        return first, at_once, second, vehicle.listeners

    (rate,), at_once, second, listeners = asyncio.run(main())
    assert (rate.kind, rate.source.message, rate.source.sensor_id) == ("range", "DISTANCE_SENSOR", 3)
    assert rate.rate_hz == pytest.approx(2.0)
    assert at_once
    assert second == ()
    assert listeners == []

"""How often laser and gimbal speak, counted while other questions to the vehicle are answered."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from sidelong.app.config import SharingSection
from sidelong.app.flight.preflight import SourceRates
from sidelong.app.link.vehicle import Vehicle
from tests.messages import attitude, laser


def at(time_s: float) -> dict:
    return {"time_boot_ms": round(1000.0 * time_s), "received_s": time_s}


def test_messages_received_before_are_counted_once_and_without_waiting(monkeypatch):
    monkeypatch.setattr("sidelong.app.flight.preflight.time", SimpleNamespace(time=lambda: 100.0))

    async def main():
        vehicle = Vehicle(SimpleNamespace(system_id=1, own_id=(245, 190)))
        rates = SourceRates(vehicle)
        for tick in range(90, 100):
            vehicle.take(attitude(**at(tick)))
            vehicle.take(laser(component=1, id=3, **at(tick + 0.25)))
            vehicle.take(laser(component=1, id=3, **at(tick + 0.75)))
        vehicle.take(attitude(**at(100.0)))
        first = await asyncio.wait_for(
            rates.received(10.0, SharingSection()), 5.0
        )  # it has listened for 10 s already
        second = await rates.received(0.0, SharingSection())
        rates.close()
        return first, second, vehicle.listeners

    (rate,), second, listeners = asyncio.run(main())
    assert (rate.kind, rate.source.message, rate.source.sensor_id) == ("range", "DISTANCE_SENSOR", 3)
    assert rate.rate_hz == pytest.approx(2.0)
    assert second == ()
    assert listeners == []

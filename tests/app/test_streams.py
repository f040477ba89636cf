"""A silent or slowed stream is requested again, and a flight ends in time although the vehicle's clock stands."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from sidelong.app.flight.flight import StoppedClock
from sidelong.app.flight.streams import StreamKeeper, announcing
from sidelong.mission.core.events import HealthChanged
from sidelong.mission.core.inputs import Input, InputReport, InputState


class Keeper:
    """A keeper whose requests are counted."""

    def __init__(self) -> None:
        self.requests = 0
        self.noted: list[str] = []
        self.keeper = StreamKeeper(self.request, self.noted.append)

    async def request(self) -> None:
        self.requests += 1


async def turns(count: int) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


@pytest.mark.parametrize("silent", [Input.POSITION, Input.ATTITUDE, Input.HEARTBEAT])
def test_silent_stream_is_requested_until_it_is_back(silent, monkeypatch):
    monkeypatch.setattr("sidelong.app.flight.streams._AGAIN_S", 0.0)

    async def flight() -> list[int]:
        kept = Keeper()
        kept.keeper.health_changed(HealthChanged(10.0, silent, InputState.STALE, "silent"))
        await turns(10)
        during = kept.requests
        kept.keeper.health_changed(HealthChanged(20.0, silent, InputState.OK, "back"))
        await turns(10)
        after = kept.requests
        await turns(10)
        return [during, after, kept.requests]

    during, after, later = asyncio.run(flight())
    assert during > 2
    assert after == later


def test_stream_of_the_payload_is_not_requested_of_the_autopilot():
    async def flight() -> int:
        kept = Keeper()
        kept.keeper.health_changed(HealthChanged(10.0, Input.LASER, InputState.STALE, "silent"))
        await turns(5)
        return kept.requests

    assert asyncio.run(flight()) == 0


def test_rate_that_another_station_has_lowered_is_requested_again(flight):
    for _, _, controller in flight(10.0):
        snapshot = controller.snapshot()

    def with_rate(time_s: float, rate_hz: float):
        report = InputReport(Input.POSITION, InputState.OK, 0.0, rate_hz, "")
        return replace(snapshot, time_s=time_s, health=(report,))

    async def flown() -> Keeper:
        kept = Keeper()
        for time_s in (100.0, 131.0):
            kept.keeper.show(with_rate(time_s, 10.0))
        await turns(5)
        assert kept.requests == 0
        kept.keeper.show(with_rate(162.0, 2.0))
        await turns(5)
        return kept

    kept = asyncio.run(flown())
    assert kept.requests == 1
    (text,) = kept.noted
    assert "position 2.0 times a second, before it was 10.0" in text


def test_error_of_background_work_is_announced_and_ends_nothing_else():
    async def flown() -> list[str]:
        noted: list[str] = []

        async def film() -> None:
            await asyncio.sleep(0)
            raise OSError("the stream is gone")

        await asyncio.gather(announcing(film(), "the camera", noted.append), turns(3))
        return noted

    (text,) = asyncio.run(flown())
    assert text.startswith("the camera: internal error, OSError('the stream is gone')")


def test_duration_goes_on_by_this_computer_while_the_vehicle_clock_stands_still():
    clock = StoppedClock(50.0, 1000.0)
    for second in range(1, 31):
        clock.update(50.0, 1000.0 + second)
    assert clock.seconds == 30.0
    clock.update(80.5, 1031.0)  # it was the messages that were silent, not the clock
    assert clock.seconds == 0.0


def test_clock_that_goes_on_after_a_stop_has_lost_that_time():
    clock = StoppedClock(50.0, 1000.0)
    clock.update(50.0, 1020.0)
    clock.update(50.5, 1020.5)
    assert clock.seconds == 20.0

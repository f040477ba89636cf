"""A watch with each payload by its own protocol, compared with the same flight on MAVLink messages."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from sidelong.app.payload.driver import RangeMeasured
from sidelong.app.payload.session import COMPONENT, fields_of
from sidelong.sitl.payload.devices import DEVICES, DeviceView
from sidelong.sitl.settings import Quirks
from tests.faults.flight import ERRORS, STEP_S, FaultedFlight, Scenario
from tests.faulty_payload import FaultyPayload
from tests.messages import message
from tests.payload.wiring import Wired

NO_QUIRKS = Quirks()
_SUBSTEPS = 10
_LEAN = 0.05
_RANGE_DELAY_S = 0.05  # mean age of the latest of ten ranges a second
_SCENARIO = Scenario(seed=5, flavour="arduplane", duration_s=300.0)
_UNPLUGGED = Scenario(seed=5, flavour="px4", duration_s=300.0)


class DeviceLoop(FaultedFlight):
    """The same flight, with the same noise, where laser and gimbal speak their maker's protocol."""

    def __init__(self, scenario: Scenario, kind: str, quirks: Quirks = NO_QUIRKS, delay_s: float = 0.02) -> None:
        self.wired = Wired(kind, quirks, delay_s=delay_s, range_delay_s=_RANGE_DELAY_S)
        self.unplugged_s: tuple[tuple[float, float], ...] = ()
        self.ranges_s: list[float] = []
        super().__init__(scenario)

    def payload(self, rng):
        return Device(rng, self)


class Device(FaultyPayload):
    """A payload whose readings go through its maker's protocol and its driver."""

    def __init__(self, rng, loop: DeviceLoop) -> None:
        super().__init__(ERRORS, rng)
        self._loop = loop
        self._before: tuple[float, DeviceView] | None = None

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, **how):
        gimbal, *laser = super().measure(time_s, boot_ms, east_m, north_m, up_m, **how)
        loop, craft = self._loop, self._loop.simulated.craft
        w, x, y, z = gimbal.fields["q"]
        forward, right, down = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        seen = DeviceView(
            laser[0].fields["current_distance"] / 100.0 if laser else None,
            math.remainder(math.atan2(right, forward) - craft.heading_rad, math.tau),
            math.asin(-down),
            _LEAN * craft.roll_rad,
        )
        before_s, before = self._before or (time_s - STEP_S, seen)
        self._before = time_s, seen
        messages = []
        for step in range(1, _SUBSTEPS + 1):
            at_s = before_s + step / _SUBSTEPS * STEP_S
            loop.wired.plugged = not any(begin_s <= at_s < end_s for begin_s, end_s in loop.unplugged_s)
            for one in loop.wired.step(_between(before, seen, step / _SUBSTEPS)):
                if isinstance(one, RangeMeasured):
                    loop.ranges_s.append(at_s)
                ago_s = time_s - at_s + loop.wired.now_s - one.time_s
                name, fields = fields_of(one, boot_ms * 1e-3 - ago_s)
                messages.append(message(name, COMPONENT, **fields))
        return messages


def _between(a: DeviceView, b: DeviceView, share: float) -> DeviceView:
    """Return what is seen between two moments; the laser's latest echo is that of the earlier."""
    turned_rad = math.remainder(b.bearing_rad - a.bearing_rad, math.tau)
    return DeviceView(
        a.range_m,
        a.bearing_rad + share * turned_rad,
        a.elevation_rad + share * (b.elevation_rad - a.elevation_rad),
        a.lean_rad + share * (b.lean_rad - a.lean_rad),
    )


@cache
def by_mavlink():
    return FaultedFlight(_SCENARIO).fly()


def error_m(flown) -> float:
    """Return the root of the mean squared error of the estimate, m."""
    errors_m = np.array([decided.target_error_m for decided in flown.decided])
    return float(np.sqrt(np.nanmean(errors_m**2)))


def shares(flown) -> tuple[float, float]:
    """Return the shares of the time on the side and in the band, percent."""
    in_band = [100.0 <= range_m <= 500.0 for range_m in flown.range_m]
    return 100.0 * float(np.mean(flown.on_side)), 100.0 * float(np.mean(in_band))


@pytest.mark.parametrize("kind", DEVICES)
def test_watch_with_the_payloads_own_protocol_is_as_good_as_with_mavlink(kind):
    flown = DeviceLoop(_SCENARIO, kind).fly()
    assert flown.yielded is None
    assert flown.ended is None
    side, band = shares(flown)
    side_by_mavlink, band_by_mavlink = shares(by_mavlink())
    assert band >= band_by_mavlink - 1.0
    assert side >= side_by_mavlink - 5.0  # one flight: of several the mean is compared, in tests/bench
    assert error_m(flown) <= 1.5 * error_m(by_mavlink())  # 1.39 is the worst of the four (SIYI)


def check_unplugged(kind):
    """Fly with a payload that is unplugged ten times, and check the reports and the watch."""
    loop = DeviceLoop(_UNPLUGGED, kind)
    loop.unplugged_s = tuple((20.0 + 27.0 * time, 26.0 + 27.0 * time) for time in range(10))
    flown = loop.fly()
    assert flown.yielded is None
    assert flown.ended is None
    texts = [text for _, text in loop.wired.reports]
    assert sum("no data" in text for text in texts) == 10
    assert sum("data again" in text for text in texts) == 10
    for _, back_s in loop.unplugged_s:
        assert any(back_s <= time_s <= back_s + 3.0 for time_s in loop.ranges_s)
    assert shares(flown)[1] >= 97.0


def test_watch_goes_on_while_the_payload_is_unplugged_ten_times():
    check_unplugged("siyi")  # the other kinds: tests/bench/test_payloads.py

"""A driver and a simulated payload at the two ends of a wire with a delay, on one clock that waits for no one."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable

import numpy as np

from sidelong.app.payload.driver import DriverSettings, Measured
from sidelong.app.payload.registry import kind_by_name
from sidelong.app.payload.session import PayloadSession
from sidelong.sitl.payload.devices import DEVICES, DeviceView
from sidelong.sitl.settings import Quirks

NO_QUIRKS, AS_IN_THE_MANUAL = Quirks(), DriverSettings()
_STEP_S = 0.01


def looking(range_m: float | None, bearing_deg: float, elevation_deg: float, lean_deg: float = 0.0):
    """Return what a payload sees at any time."""
    seen = DeviceView(range_m, math.radians(bearing_deg), math.radians(elevation_deg), math.radians(lean_deg))
    return lambda _now_s: seen


class Wired:
    """One connection. ``reports`` are the session's, each with its time."""

    def __init__(
        self,
        kind: str,
        quirks: Quirks = NO_QUIRKS,
        settings: DriverSettings = AS_IN_THE_MANUAL,
        delay_s: float = 0.0,
        seed: int = 1,
        range_delay_s: float = 0.0,
        *,
        echoes: bool = False,
    ) -> None:
        """echoes: whether the line returns what is sent to the device, as some serial adapters do."""
        self._kind, self._quirks, self._seed = kind, quirks, seed
        self.driver = kind_by_name(kind).make(settings)
        self.device = DEVICES[kind](quirks, np.random.default_rng(seed))
        self.reports: list[tuple[float, str]] = []
        self.session = PayloadSession(kind, self.driver, self._note, range_delay_s)
        self.now_s = 0.0
        self.plugged = True
        self._delay_s, self._echoes = delay_s, echoes
        self._steps = 0
        self._order = itertools.count()
        self._flying: list[tuple[float, int, bool, bytes]] = []

    def _note(self, text: str) -> None:
        self.reports.append((self.now_s, text))

    def restart_device(self) -> None:
        """Switch the payload off and on: it knows nothing of what it was asked before."""
        self.device = DEVICES[self._kind](self._quirks, np.random.default_rng(self._seed))

    def step(self, seen: DeviceView) -> list[Measured]:
        """Go on by 10 ms and return what was measured."""
        self._steps += 1
        self.now_s = self._steps * _STEP_S
        for frame in self.session.due(self.now_s):
            self._put(True, frame)
        for frame in self.device.stream(self.now_s, seen):
            self._put(False, frame)
        measured: list[Measured] = []
        while self._flying and self._flying[0][0] <= self.now_s + 1e-9:
            _, _, to_device, frame = heapq.heappop(self._flying)
            if to_device:
                for reply in self.device.receive(frame, self.now_s, seen):
                    self._put(False, reply)
            else:
                measured += self.session.receive(frame, self.now_s)
        return measured

    def run(self, duration_s: float, sees: Callable[[float], DeviceView]) -> list[Measured]:
        """Go on for a while and return what was measured."""
        return [one for _ in range(round(duration_s / _STEP_S)) for one in self.step(sees(self.now_s + _STEP_S))]

    def _put(self, to_device: bool, frame: bytes) -> None:
        if self.plugged:
            heapq.heappush(self._flying, (self.now_s + self._delay_s, next(self._order), to_device, frame))
            if to_device and self._echoes:
                heapq.heappush(self._flying, (self.now_s, next(self._order), False, frame))

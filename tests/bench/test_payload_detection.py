"""Time until a fault of the payload is found: python -m pytest tests/bench/test_payload_detection.py -s

The readings of flights without faults are recorded once and checked again with each fault; no flight follows them.
Takes a minute of CPU. SIDELONG_DETECTION=COUNT,FIRST: flights, and the first target.
"""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from sidelong.estimators.sensing.readings import GimbalReading, RangeReading
from sidelong.estimators.tracking.payload_fit import PayloadFit
from tests.bench.size import size
from tests.faults.flight import FLAVOURS, FaultedFlight, Scenario
from tests.faults.flight_campaign import REPORTED_WITHIN_S

DURATION_S, GIVE_UP_S = 240.0, 60.0
BEGINS_S = (30.0, 65.0, 100.0, 150.0)
FIRST_BEGIN_S = 0.0  # nothing is known yet of the target's motion before the fault
_METHODS = ("position", "attitude", "range", "gimbal")

Fault = Callable[[Any, list[Any]], Any]
"""Returns what becomes of a reading; the list is the fault's memory."""


def _repeated(kind: type, field: str) -> Fault:
    def change(reading: Any, first: list[Any]) -> Any:
        if not isinstance(reading, kind):
            return reading
        first += [] if first else [getattr(reading, field)]
        return replace(reading, **{field: first[0]})

    return change


def _changed(kind: type, change: Callable[[Any], dict[str, object]]) -> Fault:
    return lambda reading, _: replace(reading, **change(reading)) if isinstance(reading, kind) else reading


def _scaled(factor: float) -> Fault:
    return _changed(RangeReading, lambda reading: {"slant_range_m": round(factor * reading.slant_range_m, 2)})


FAULTS: dict[str, Fault] = {
    "stuck laser": _repeated(RangeReading, "slant_range_m"),
    "frozen gimbal": _repeated(GimbalReading, "quaternion_wxyz"),
    "range in a tenth": _scaled(0.1),
    "range in feet": _scaled(0.3048),
    "flags: vehicle frame": _changed(GimbalReading, lambda _: {"frame": "vehicle"}),
    "flags: body frame": _changed(GimbalReading, lambda _: {"frame": "body"}),
}


def recorded(seed: int) -> list[tuple[str, Any]]:
    """Return what the payload check receives in a flight without faults."""
    log: list[tuple[str, Any]] = []
    with pytest.MonkeyPatch.context() as patch:
        for name in _METHODS:
            method = getattr(PayloadFit, name)

            def note(check: PayloadFit, reading: Any, *how: Any, name: str = name, method: Any = method) -> None:
                log.append((name, reading))
                method(check, reading, *how)

            patch.setattr(PayloadFit, name, note)
        FaultedFlight(Scenario(seed, list(FLAVOURS)[seed % 2], DURATION_S)).fly()
    return log


def found_after_s(log: list[tuple[str, Any]], fault: Fault, begin_s: float) -> float:
    """Return how soon a fault of laser or gimbal is found; infinite if not at all."""
    check, memory, begin_s = PayloadFit(), [], begin_s + log[0][1].time_s
    for name, reading in log:
        after_s = reading.time_s - begin_s
        getattr(check, name)(fault(reading, memory) if after_s >= 0.0 else reading)
        if check.laser_fault or check.gimbal_fault:
            return after_s
        if after_s > GIVE_UP_S:
            break
    return math.inf


def test_faults_of_the_payload_are_found_in_time():
    count, first = map(int, os.environ.get("SIDELONG_DETECTION", f"{size(40, 1)},0").split(","))
    logs = [recorded(seed) for seed in range(first, first + count)]
    print(f"\n{'fault':24}{'begins':>8}{'found, s: median':>18}{'worst':>7}", end="")
    print(f"{'begun at takeover: median':>27}{'worst':>7}")
    worst_s = []
    for name, fault in FAULTS.items():
        found_s = [found_after_s(log, fault, begin_s) for log in logs for begin_s in BEGINS_S]
        at_once_s = [found_after_s(log, fault, FIRST_BEGIN_S) for log in logs]
        worst_s.append(max(found_s))
        print(f"{name:24}{len(found_s):8}{statistics.median(found_s):18.1f}{worst_s[-1]:7.1f}", end="")
        print(f"{statistics.median(at_once_s):27.1f}{max(at_once_s):7.1f}")
    assert all(found_after_s(log, lambda reading, _: reading, math.inf) == math.inf for log in logs)
    assert max(worst_s) <= REPORTED_WITHIN_S

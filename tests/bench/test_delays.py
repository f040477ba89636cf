"""Late stamps of laser and gimbal: estimated and corrected in the closed loop, next to recorded targets.

``python -m pytest tests/bench/test_delays.py -s`` flies each target with each delay. SIDELONG_TARGETS names the
folder of recorded tracks; without it the targets are random. SIDELONG_RUNS: targets per delay. SIDELONG_DURATION: of
each flight, s. SIDELONG_DRAWS: flights with other noise next to each target. "configured": each flight starts from
the delays that an earlier one found, a little wrong.

The flights of one target diverge at the first decision that differs: with a delay of 1 ms, 24 targets have lost 1.2
points of side on one draw. So several draws are averaged, those without delay as well.
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from sidelong.app.study import closed_loop
from sidelong.app.study.recorded import recorded_targets
from sidelong.app.study.settings import (
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.app.study.study import table_of
from sidelong.estimators.tracking.tracker import Tracker
from tests.faulty_payload import FaultyPayload, PayloadFaults

DELAYS_S = tuple(map(float, os.environ.get("SIDELONG_DELAYS", "0,0.2,0.5,1,2").split(",")))
RUNS = int(os.environ.get("SIDELONG_RUNS", "12"))
DRAWS = int(os.environ.get("SIDELONG_DRAWS", "3"))
BY_S = 300.0
_FOUND_OFF_S = 0.03  # error of the delays that an earlier flight found
DURATION_S = float(os.environ.get("SIDELONG_DURATION", "1200"))


def settings() -> StudySettings:
    plain = StudySettings(
        runs=RUNS,
        noise_draws=DRAWS,
        duration_s=DURATION_S,
        config=studied(airspeed_m_s=12.0, radius_m=40.0, target_speed_max_m_s=5.0),
    )
    folder = os.environ.get("SIDELONG_TARGETS")
    if folder is None:
        return plain
    tracks = [one for one in recorded_targets([Path(folder)], 5.0).flown if one.duration_s >= 600.0]
    chosen = tuple(tracks[k] for k in np.linspace(0, len(tracks) - 1, min(RUNS, len(tracks))).astype(int))
    return replace(plain, runs=len(chosen), tracks=chosen)


class _Observed(Tracker):
    """Keeps the delays that are used at a time of the flight."""

    seen: ClassVar[list[list[tuple[float, float, float]]]] = []

    def __init__(self, given) -> None:
        super().__init__(given)
        self.seen.append([])
        self._log = self.seen[-1]

    def estimate(self, now_s):
        self._log.append((now_s, self._pairing.gimbal_delay_s, self._pairing.range_delay_s))
        return super().estimate(now_s)


def fly(
    flown: StudySettings, gimbal_s: float, range_s: float, monkeypatch: pytest.MonkeyPatch, configured: bool = False
):
    """Return side share, least range and the errors of both delays at BY_S, one row for each target of each draw."""
    payload_of = closed_loop.payload_of

    def late(one: StudySettings):
        errors, given = payload_of(one)
        if configured:
            known_s = gimbal_s + _FOUND_OFF_S, range_s - _FOUND_OFF_S
            given = replace(given, gimbal_latency_s=known_s[0], range_latency_s=known_s[1])
        return PayloadFaults(**asdict(errors), gimbal_delay_s=gimbal_s, range_delay_s=range_s), given

    rows, table = [], table_of(flown)
    with monkeypatch.context() as patched:
        patched.setattr(closed_loop, "payload_of", late)
        patched.setattr(closed_loop, "Payload", FaultyPayload)
        patched.setattr(closed_loop, "Tracker", _Observed)
        for number in flown.numbers:
            result = closed_loop.run(flown, PREDICTIVE, number, table)
            log = np.array(_Observed.seen.pop())
            at = log[np.searchsorted(log[:, 0], log[0, 0] + BY_S)]
            rows.append((result.time_on_side, result.min_range_m, at[1] - gimbal_s, at[2] - range_s))
    return np.array(rows)


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("configured", [False, True], ids=["found", "configured"])
def test_delays_are_found_within_300_s_and_do_not_cost_side(configured, monkeypatch):
    flown, misses = settings(), []
    prompt = fly(flown, 0.0, 0.0, monkeypatch)
    print(f"\n{len(prompt)} flights; delay of gimbal and laser: median error, worst; side, least range")
    for delay_s in DELAYS_S:
        for gimbal_s, range_s in {(delay_s, 0.0), (0.0, delay_s), (delay_s, delay_s)}:
            rows = prompt if delay_s == 0.0 else fly(flown, gimbal_s, range_s, monkeypatch, configured)
            error_s = np.abs(rows[:, 2:])
            gained = np.nanmean(100.0 * (rows[:, 0] - prompt[:, 0]).reshape(DRAWS, -1), axis=0)
            gained = gained[np.isfinite(gained)]
            spread = gained.std() / math.sqrt(max(len(gained), 1))
            print(
                f"{gimbal_s:.1f} {range_s:.1f}: {np.median(error_s[:, 0]):.3f} {np.median(error_s[:, 1]):.3f} s, "
                f"{error_s[:, 0].max():.2f} {error_s[:, 1].max():.2f} s; side {100 * np.nanmean(rows[:, 0]):.1f} % "
                f"({gained.mean():+.1f} +- {spread:.1f}), least {rows[:, 1].min():.0f} m",
                flush=True,
            )
            missed = (
                np.median(error_s, axis=0).max() > 0.05,
                gained.mean() < -0.5 - 2.0 * spread,
                rows[:, 1].min() < 95.0,
            )
            if any(missed):
                misses.append((gimbal_s, range_s, *missed))
    assert misses == []

"""Your own SITL programs until the battery sends them home, next to what was predicted at half of it.

    SIDELONG_PROGRAMS=FOLDER python -m pytest tests/bench/test_real_endurance.py -s

ENDURANCE is how long the battery lasts (s), RATE how many times the clock.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys

import pytest

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.mission.control.alarms import LOW_BATTERY
from sidelong.mission.core.events import BatteryReported, End
from tests.autopilot.real_vehicle import FLAVOURS, ROOT, RealVehicle, configured

pytestmark = pytest.mark.timeout(7200)

RATE, ENDURANCE_S = float(os.environ.get("RATE", "4")), float(os.environ.get("ENDURANCE", "1500"))
WRONG_MAX = 0.1


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_return_is_predicted_at_half_of_the_battery(flavour, tmp_path):
    config = configured(tmp_path / "mission.toml", flavour, "[requirement]\ntarget_speed_max_m_s = 4\n")
    options = ("--speed", RATE, "--set", f"endurance_s={ENDURANCE_S}", "--target", "circle")
    with RealVehicle(flavour, *options) as vehicle, (tmp_path / "reported.txt").open("w") as announced:
        command = [sys.executable, "-m", "sidelong.app", "launch", config, "--connect", vehicle.urls[0]]
        command += ["--duration", 2.0 * ENDURANCE_S, "--out", tmp_path / "runs"]
        subprocess.run(list(map(str, command)), stdout=announced, stderr=announced, cwd=ROOT, check=False)
    (run,) = (tmp_path / "runs").iterdir()
    events = list(JournalReader(run / "journal.jsonl", JOURNAL_TYPES))
    battery = [one for one in events if isinstance(one, BatteryReported)]
    (end,) = (one for one in events if isinstance(one, End))
    half = next(one for one in battery if one.percent <= 50.0)
    last = [one for one in battery if one.time_s <= end.time_s][-1]
    flown_s, predicted_s = end.time_s - half.time_s, half.left_s - LOW_BATTERY * last.home_s
    wrong = abs(predicted_s - flown_s) / flown_s
    print(
        f"\n{flavour}: at {half.percent:.0f} % the return was predicted in {predicted_s:.0f} s; "
        f"it began after {flown_s:.0f} s at {last.percent:.0f} %, {last.home_s:.0f} s from home: {wrong:.1%} off"
    )
    assert end.action == "return"
    assert math.isfinite(predicted_s)
    assert wrong <= WRONG_MAX

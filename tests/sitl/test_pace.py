"""A simulation waits for the program that flies its vehicle."""

import math
import os
import subprocess
import sys
import time

import pytest

from sidelong.sitl.pace import Pace


def test_it_waits_for_who_is_behind_but_not_for_who_is_silent():
    pace = Pace(speed=20.0)
    assert pace.limit_s(0.0) == math.inf
    pace.follow(100.0, now_s=5.0)
    assert pace.limit_s(6.0) == pytest.approx(100.7)
    pace.follow(101.0, now_s=6.5)
    assert pace.limit_s(8.0) == pytest.approx(101.7)
    assert pace.limit_s(9.0) == math.inf
    fast = Pace(speed=1000.0)  # what the machine cannot hold makes no answer later
    fast.follow(100.0, now_s=5.0)
    assert fast.limit_s(5.0) == 100.75


def test_a_simulation_goes_no_further_than_its_program_has_come(tmp_path):
    truth = tmp_path / "truth.csv"
    command = [
        sys.executable,
        "-m",
        "sidelong.sitl",
        "--to",
        "127.0.0.1:9",
        "--speed",
        "50",
        "--while-input",
        "--truth",
        truth,
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as vehicle:
        assert vehicle.stdout.readline().startswith(b"ready")
        # For a while its program is at 1 s of the vehicle's time: 1.5 s of the wall clock would be 75 s.
        end_s = time.monotonic() + 1.5
        while time.monotonic() < end_s:
            os.write(vehicle.stdin.fileno(), b"1.0\n")
            time.sleep(0.05)
        vehicle.stdin.close()
        vehicle.wait(10.0)
    reached_s = float(truth.read_text().splitlines()[-1].split(",")[0])
    assert 1.0 < reached_s < 40.0

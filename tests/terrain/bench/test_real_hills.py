"""Real autopilots over real hills: the clearance by their own terrain data and by the truth.

SIDELONG_ARDUPLANE=PATH SIDELONG_PX4=PATH python -m pytest tests/terrain/bench/test_real_hills.py -s
flies 20 minutes with each at SPEED=4 times the clock. ArduPlane asks for heights and is answered from our tiles.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys

import pytest
from pymavlink import mavutil

from sidelong.app.analysis.truth import read_truth
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.app.terrain.elevation_data import elevation_data
from sidelong.mission.core.events import ControlAcquired
from tests.autopilot.real_vehicle import FLAVOURS, ROOT, RealVehicle, configured

HOME_DEG = (36.59, -84.24)
SPEED, DURATION_S = int(os.environ.get("SPEED", "4")), int(os.environ.get("DURATION_S", "1200"))
CLEARANCE_M, SPARE_M = 50.0, 10.0  # flown heights swing a little about the planned ones
OFF_MAX_M = 30.0  # posts 100 m apart, against 90 m

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(0)]


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_twenty_minutes_above_the_ground(tmp_path, flavour, hills_folder):
    config = configured(
        tmp_path / "mission.toml",
        flavour,
        f"height_above = 'ground'\nclearance_m = {CLEARANCE_M}\n[terrain]\nfolder = '{hills_folder}'\n",
    )
    truth_file, home = tmp_path / "truth.csv", ",".join(map(str, HOME_DEG))
    sitl = ("--speed", SPEED, "--terrain", hills_folder, "--home", home, "--target-speed", 3, "--truth", truth_file)
    with RealVehicle(flavour, *sitl) as vehicle:
        command = [sys.executable, "-m", "sidelong.app", "launch", config, "--connect", vehicle.urls[0]]
        command += ["--duration", DURATION_S, "--out", tmp_path / "runs", "--json", tmp_path / "summary.json"]
        flight = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, cwd=ROOT)
    assert flight.returncode == 0, flight.stdout + flight.stderr
    (run,) = (tmp_path / "runs").iterdir()
    events = JournalReader(run / "journal.jsonl", JOURNAL_TYPES)
    begin_s = next(event.time_s for event in events if isinstance(event, ControlAcquired))
    in_sight, clearance_m = read_truth(truth_file).over_ground(begin_s)
    given = reported(run / "flight.tlog", begin_s)
    summary = json.loads((tmp_path / "summary.json").read_text())
    print(
        f"\n{flavour:9} load {os.getloadavg()[0]:.1f}: in sight {in_sight:.3f}, least height over ground "
        f"{clearance_m:.1f} m by the truth, {summary['min_clearance_m']:.1f} m by the estimate\n{summary}"
    )
    assert summary["outcome"] == "completed"
    assert clearance_m >= CLEARANCE_M - SPARE_M
    if flavour == "arduplane":
        data = elevation_data(hills_folder)
        off_m = [height_m - data.height_above_sea_m(*place) for place, height_m, _ in given]
        least_m = min(above_m for _, _, above_m in given)
        print(
            f"{len(given)} TERRAIN_REPORTs: least height over ground {least_m:.1f} m, heights differ from ours by "
            f"{statistics.pstdev(off_m, 0.0):.1f} m (RMS), at most {max(map(abs, off_m)):.1f} m"
        )
        assert least_m >= CLEARANCE_M - SPARE_M
        assert max(map(abs, off_m)) < OFF_MAX_M


def reported(tlog, begin_s):
    """Return of each TERRAIN_REPORT the place in degrees, its height above the sea, and the aircraft's over it."""
    log, time_s, found = mavutil.mavlink_connection(str(tlog)), -math.inf, []
    while (message := log.recv_match(type=["GLOBAL_POSITION_INT", "TERRAIN_REPORT"])) is not None:
        if message.get_type() == "GLOBAL_POSITION_INT":
            time_s = message.time_boot_ms * 1e-3
        elif message.spacing and time_s >= begin_s:
            place_deg = (message.lat * 1e-7, message.lon * 1e-7)
            found.append((place_deg, message.terrain_height, message.current_height))
    return found

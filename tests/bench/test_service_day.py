"""A day of the service on board: python -m pytest tests/bench/test_service_day.py -s

HOURS is how many hours the vehicle flies, with a watch of an hour every second hour; SPEED how many times the clock.
Memory must stay flat, the records within their budget, each watch complete and repeatable.
"""

from __future__ import annotations

import json
import os
import subprocess
from itertools import pairwise

import psutil
import pytest

from tests.autopilot.conftest import vehicle_of  # noqa: F401  # a fixture
from tests.bench.size import size
from tests.bench.test_service import Service
from tests.command_line import SIDELONG

pytestmark = [pytest.mark.udp, pytest.mark.timeout(4 * 3600)]

HOURS, WATCHES = size(24, 0, "HOURS"), size(12, 1)
SPEED = float(os.environ.get("SPEED", "20"))
BUDGET_MB = 120.0  # two watches or three
LOOK_EVERY_S, ROTATED_EVERY_S = 300.0, 60.0
GROWTH_MAX = 0.05


def test_memory_is_flat_and_the_records_stay_in_their_budget(vehicle_of, tmp_path):  # noqa: F811
    config, out = tmp_path / "mission.toml", tmp_path / "runs"
    config.write_text(f"[control]\ndisk_budget_mb = {BUDGET_MB}\n")
    vehicle = vehicle_of("arduplane", speed=SPEED, motion="circle", endurance_s=1000.0 * 3600.0)
    memory_mb, disk_mb, runs = [], [], []
    with Service(vehicle.url, tmp_path, str(config)) as service:
        service.until("ready")
        process = psutil.Process(service.process.pid)
        for number in range(WATCHES):
            for state in ("watching", "ready"):
                assert service.ask("watch" if state == "watching" else "release").returncode == 0
                run = service.until(state)["run"]
                for _ in range(max(round(HOURS / WATCHES / 2.0 * 3600.0 / LOOK_EVERY_S), 1)):
                    vehicle.wait(LOOK_EVERY_S)
                    assert service.status["state"] == state
                    memory_mb.append(process.memory_info().rss / 1e6)
                    disk_mb.append(sum(file.stat().st_size for file in out.rglob("*") if file.is_file()) / 1e6)
            runs.append(tmp_path / run)
            print(f"watch {number + 1}: memory {memory_mb[-1]:.0f} MB, records {disk_mb[-1]:.0f} MB", flush=True)
        service.process.terminate()
        assert service.process.wait(60.0) == 0
        assert "Traceback" not in service.announced
    kept = [run for run in runs if run.exists()]
    for run in kept:
        summary = json.loads((run / "summary.json").read_text())
        print(f"{run.name}: {summary['outcome']}")
        assert summary["outcome"].startswith("ended")
    verified = subprocess.run([SIDELONG, "replay", kept[-1], "--verify"], capture_output=True, text=True, check=False)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    each = len(memory_mb) // WATCHES
    first_mb, last_mb = max(memory_mb[:each]), max(memory_mb[-each:])
    # The budget is kept once a minute of the clock, in which a simulation may record for longer.
    over_mb = max(b - a for a, b in pairwise(disk_mb)) * SPEED * ROTATED_EVERY_S / LOOK_EVERY_S
    print(
        f"\n{HOURS} h with {WATCHES} watches: memory {first_mb:.1f} MB in the first, {last_mb:.1f} MB in the last; "
        f"records at most {max(disk_mb):.0f} MB of {BUDGET_MB:g} and {over_mb:.0f} between two looks at the disk; "
        f"{len(kept)} of {len(runs)} runs kept"
    )
    assert last_mb <= (1.0 + GROWTH_MAX) * first_mb
    assert max(disk_mb) <= BUDGET_MB + over_mb
    assert runs[-1] in kept

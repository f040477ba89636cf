"""Nothing compiles or loads compiled code in flight: all kernels that a flight calls have run before it begins."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
COMPARED = """
import sys
from pathlib import Path
from sidelong.estimators.compiled import KERNELS

def compiled():
    return {kernel: set(kernel.signatures) for kernel in KERNELS}

def compare(before):
    print(*(kernel.py_func.__name__ for kernel, now in compiled().items() if now - before.get(kernel, set())))
"""
ALONE = """
from tests.faults.flight import FaultedFlight, Scenario

flight = FaultedFlight(Scenario(3, "px4"), terrain=sys.argv[1])
before = compiled()
flown = flight.fly()
assert sum(decided.moved for decided in flown.decided) > 0
compare(before)
"""
FLEET = """
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.fleet.events import TargetRouteGiven
from tests.exchange.conftest import Flight
from tests.exchange.test_fleet import Fleet

fleet = Fleet(Flight, Path(sys.argv[1]))
before = compiled()
fleet.coordination.put(
    TargetRouteGiven("target", RouteGiven(0.0, (-900.0, 900.0), (0.0, 600.0), False, 10.0, None, "either"))
)
fleet.take_off()
fleet.run(90.0)
assert sum(craft.flight.core.controller.changes.moves for craft in fleet.crafts) > 0
compare(before)
"""


def kernels_after_the_warm_up(script, argument=""):
    done = subprocess.run(
        [sys.executable, "-c", COMPARED + script, str(argument)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("over_hills", [False, True])
def test_no_kernel_is_compiled_or_loaded_after_the_warm_up(over_hills, tmp_path):
    at = np.linspace(0.0, 120.0, 1201)
    waves_m = 400.0 + 15.0 * np.sin(at)[:, None] * np.cos(at)
    waves_m.astype(">i2").tofile(tmp_path / "N47E008.hgt")
    assert kernels_after_the_warm_up(ALONE, tmp_path if over_hills else "") == []


def test_no_kernel_is_compiled_or_loaded_while_a_fleet_flies(tmp_path):
    assert kernels_after_the_warm_up(FLEET, tmp_path) == []

"""Nothing compiles or loads compiled code in flight: all kernels that a flight calls have run before it begins."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FLIGHT = """
from sidelong.estimators.compiled import KERNELS
from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from tests.faults.flight import FaultedFlight, Scenario

# The simulated aircraft is compiled, too, but flies in no program that commands a real one.
KinematicAircraft(AircraftState(0.0, 0.0, 0.0, 0.0, 15.0, 0.0), 15.0, 0.7, 0.5, Wind()).step(0.0, 0.1)
flight = FaultedFlight(Scenario(3, "px4"))
before = {kernel: set(kernel.signatures) for kernel in KERNELS}
flown = flight.fly()
assert sum(decided.moved for decided in flown.decided) > 0
print(*(kernel.py_func.__name__ for kernel in KERNELS if set(kernel.signatures) - before.get(kernel, set())))
"""


def test_no_kernel_is_compiled_or_loaded_after_the_warm_up():
    done = subprocess.run(
        [sys.executable, "-c", FLIGHT],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []

import subprocess
import sys

_PROGRAM = """
import re
import numpy as np
from pathlib import Path
from sidelong.app.serve.resident import release_unused
import sidelong.estimators.compiled

def resident_mb():
    return int(re.search(r"VmRSS:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1e3

before_mb = resident_mb()
release_unused()
print(before_mb - resident_mb())
assert np.allclose(np.linalg.solve(2.0 * np.eye(3), np.ones(3)), 0.5)  # what was dropped comes again
"""


def test_pages_of_libraries_are_dropped_and_come_again():
    done = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True, timeout=60.0)
    assert float(done.stdout) > 20.0

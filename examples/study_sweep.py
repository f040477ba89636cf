"""Sweep the largest range in a study, read its table with numpy, and print the best one.

Usage: python examples/study_sweep.py [PICTURE.png]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

RANGES_M = (350, 500)


def main() -> None:
    """Run two targets of five minutes for each value."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "sweep.csv"
        options = ["--sweep", f"requirement.range_max_m={','.join(map(str, RANGES_M))}"]
        command = [
            "study",
            "--planner",
            "lvfg",
            "--runs",
            "2",
            "--duration",
            "300",
            "--jobs",
            "1",
            "--export",
            str(table),
        ]
        program = [sys.executable, "-P", "-m", "sidelong.app"]
        subprocess.run([*program, *command, *options], check=True, stdout=subprocess.DEVNULL)
        runs = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
    # genfromtxt drops the dot of "requirement.range_max_m".
    shares = [100.0 * runs["time_on_side"][runs["requirementrange_max_m"] == range_m].mean() for range_m in RANGES_M]
    best = int(np.argmax(shares))
    print(f"best: {RANGES_M[best]} m, {shares[best]:.1f} % on side")
    if len(sys.argv) > 1:
        plt.bar([f"{range_m} m" for range_m in RANGES_M], shares)
        plt.xlabel("requirement.range_max_m")
        plt.ylabel("on side, %")
        plt.savefig(sys.argv[1])


if __name__ == "__main__":
    main()

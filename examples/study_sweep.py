"""Sweep the largest range in a study, read its table with numpy, and print the best design.

Usage: python examples/study_sweep.py [PICTURE.png]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

AIRSPEEDS_M_S, RANGES_M = (12,), (350, 500)


def main() -> None:
    """Run two targets of five minutes for each design."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "sweep.csv"
        sweeps = (
            f"aircraft.airspeed_m_s={','.join(map(str, AIRSPEEDS_M_S))}",
            f"requirement.range_max_m={','.join(map(str, RANGES_M))}",
        )
        options = [word for sweep in sweeps for word in ("--sweep", sweep)]
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
    shares = np.zeros((len(AIRSPEEDS_M_S), len(RANGES_M)))
    for row, airspeed_m_s in enumerate(AIRSPEEDS_M_S):
        for column, range_m in enumerate(RANGES_M):
            own = (runs["airspeed_m_s"] == airspeed_m_s) & (runs["range_max_m"] == range_m)
            shares[row, column] = 100.0 * runs["time_on_side"][own].mean()
    row, column = np.unravel_index(shares.argmax(), shares.shape)
    print(f"best: {AIRSPEEDS_M_S[row]} m/s, {RANGES_M[column]} m, {shares.max():.1f} % on side")
    if len(sys.argv) > 1:
        plt.imshow(shares, vmin=50.0, vmax=100.0)
        plt.xticks(range(len(RANGES_M)), [f"{range_m} m" for range_m in RANGES_M])
        plt.yticks(range(len(AIRSPEEDS_M_S)), [f"{airspeed} m/s" for airspeed in AIRSPEEDS_M_S])
        plt.colorbar(label="on side, %")
        plt.savefig(sys.argv[1])


if __name__ == "__main__":
    main()

"""Read a recorded flight and analyse it with numpy: range, and speed of the target.

Usage: python examples/replay_analysis.py RUN|LOG [PICTURE.png]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sidelong.app.report.history import read_flight


def main() -> None:
    """Print statistics of the range and of the target's speed."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    history = read_flight(Path(sys.argv[1])).history
    estimates = np.array([(one.time_s, one.east_m, one.north_m, one.speed_m_s) for one in history.estimates])
    time_s, aircraft = estimates[:, 0], history.aircraft
    east_m = np.interp(time_s, aircraft.time_s, aircraft.east_m) - estimates[:, 1]
    north_m = np.interp(time_s, aircraft.time_s, aircraft.north_m) - estimates[:, 2]
    range_m = np.hypot(east_m, north_m)
    print(f"flight: {time_s[-1] - time_s[0]:.0f} s, {len(time_s)} estimates")
    print("range: {:.0f}, {:.0f}, {:.0f} m (least, median, greatest)".format(*np.percentile(range_m, (0, 50, 100))))
    print("speed of the target: {:.1f}, {:.1f} m/s (median, 95 %)".format(*np.percentile(estimates[:, 3], (50, 95))))
    if len(sys.argv) > 2:
        plt.plot(time_s, range_m)
        plt.xlabel("time, s")
        plt.ylabel("range, m")
        plt.savefig(sys.argv[2])


if __name__ == "__main__":
    main()

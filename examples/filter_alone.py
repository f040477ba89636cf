"""Track a target with the filter alone: simulated ranges and bearings in, position and velocity out.

Usage: python examples/filter_alone.py [PICTURE.png]
"""

import sys
from math import atan2, cos, hypot, sin

import matplotlib.pyplot as plt
import numpy as np

from sidelong import Sighting, Track, TrackerSettings

RANGE_SIGMA_M, ANGLE_SIGMA_RAD = 0.8, 0.006


def main() -> None:
    """Circle a target that walks north and turns east, and print the error of the estimate."""
    rng, track, rows = np.random.default_rng(1), Track(TrackerSettings()), []
    for second in range(180):
        target_m = (1.5 * max(second - 90, 0), 1.5 * min(second, 90))
        phase_rad = second / 4.0  # one orbit of 50 m radius in 25 s
        aircraft_m = (-250.0 + 50.0 * cos(phase_rad), 60.0 + 50.0 * sin(phase_rad))
        east_m, north_m = target_m[0] - aircraft_m[0], target_m[1] - aircraft_m[1]
        range_m = hypot(east_m, north_m) + rng.normal(0.0, RANGE_SIGMA_M)
        bearing_rad = atan2(east_m, north_m) + rng.normal(0.0, ANGLE_SIGMA_RAD)
        sigmas = (RANGE_SIGMA_M, ANGLE_SIGMA_RAD, ANGLE_SIGMA_RAD)
        track.add(Sighting(float(second), range_m, bearing_rad, 0.0, *sigmas, *aircraft_m))
        estimate = track.estimate(float(second))
        rows.append((*target_m, estimate.east_m, estimate.north_m, *aircraft_m))
    all_m = np.array(rows)
    error_m = np.hypot(*(all_m[30:, 0:2] - all_m[30:, 2:4]).T)
    print(f"error of the position: {np.sqrt(np.mean(error_m**2)):.1f} m (RMS, after 30 s)")
    if len(sys.argv) > 1:
        for column, label in ((0, "target"), (2, "estimate"), (4, "aircraft")):
            plt.plot(all_m[:, column], all_m[:, column + 1], label=label)
        plt.axis("equal")
        plt.xlabel("east, m")
        plt.ylabel("north, m")
        plt.legend()
        plt.savefig(sys.argv[1])


if __name__ == "__main__":
    main()

"""Steer the aircraft from outside: sidelong study --benchmark --controller "python examples/controller.py"."""

import csv
import sys
from math import atan2, cos, hypot, pi, sin

ORBIT_M, GAIN_PER_S = 120.0, 0.6  # radius of the orbit around a point next to the target

for row in csv.DictReader(sys.stdin):  # a row every 0.2 s; the program ends with its input
    state = {name: float(value) for name, value in row.items() if name != "side"}
    right = 1.0 if row["side"] == "right" else -1.0
    target_course = atan2(state["target_velocity_east_m_s"], state["target_velocity_north_m_s"])
    offset_m = 0.5 * (state["range_min_m"] + state["range_max_m"])
    east = state["aircraft_east_m"] - state["target_east_m"] - offset_m * sin(target_course + right * pi / 2)
    north = state["aircraft_north_m"] - state["target_north_m"] - offset_m * cos(target_course + right * pi / 2)
    # Lyapunov vector field around that point, clockwise: inward when far, tangential on the orbit.
    distance = hypot(east, north)
    radial = -(distance**2 - ORBIT_M**2) / (distance**2 + ORBIT_M**2)
    around = 2.0 * distance * ORBIT_M / (distance**2 + ORBIT_M**2)
    course = atan2(radial * east + around * north, radial * north - around * east)
    error = (course - state["aircraft_course_rad"] + pi) % (2.0 * pi) - pi
    most = state["turn_rate_max_rad_s"]
    print(min(max(GAIN_PER_S * error + state["ground_speed_m_s"] / ORBIT_M, -most), most), flush=True)

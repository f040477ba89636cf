"""The estimation on the flown logs, whole: python -m pytest tests/bench -s."""

from __future__ import annotations

import csv
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.tlog import read_tlog
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.tracker import Tracker

DATA = Path(__file__).resolve().parent.parent / "data"
CHI2_95 = 5.991


def test_the_flown_logs():
    rows = [
        ["log", "filter", "RMSE", "after 120 s", "95 % ellipse holds", "yaw bias (0.4 put in)", "time for the log"]
    ]
    for name in ("arduplane-follow-bike", "px4-follow-walk-and-drive"):
        telemetry = Telemetry(system_id=1)
        events = [telemetry.event(message) for message in read_tlog(DATA / f"{name}.tlog", telemetry.wanted)]
        readings = [
            e for e in events if isinstance(e, PositionReading | AttitudeReading | RangeReading | GimbalReading)
        ]
        with (DATA / f"{name}.truth.csv").open() as file:
            truth = np.array([[float(value) for value in row.values()] for row in csv.DictReader(file)])
        assert telemetry.plane is not None
        places = np.array([telemetry.plane.east_north_m(row[1], row[2]) for row in truth])
        for kind in ("imm", "ekf"):
            tracker, row, newest_s = Tracker(replace(TrackerSettings(), filter=kind)), 0, 0.0
            squares, nees, times_s = [], [], []
            started_s = time.process_time()
            for reading in readings:
                tracker.add(reading)
                newest_s = max(newest_s, reading.time_s)
                while row < len(truth) and truth[row, 0] < newest_s:
                    estimate = tracker.estimate(truth[row, 0])
                    if estimate is not None:
                        error = np.array((estimate.east_m, estimate.north_m)) - places[row]
                        squares.append(error @ error)
                        nees.append(error @ np.linalg.solve(estimate.covariance[:2, :2], error))
                        times_s.append(truth[row, 0])
                    row += 1
            took_s = time.process_time() - started_s
            late = np.array(squares)[np.array(times_s) > times_s[0] + 120.0]
            known = tracker.calibration
            yaw_deg, sigma_deg = math.degrees(known.yaw_bias_rad), math.degrees(known.yaw_sigma_rad)
            rows.append(
                [
                    name,
                    kind,
                    f"{math.sqrt(np.mean(squares)):.2f} m",
                    f"{math.sqrt(np.mean(late)):.2f} m",
                    f"{100 * np.mean(np.array(nees) < CHI2_95):.1f} %",
                    f"{yaw_deg:.2f} +- {sigma_deg:.2f} deg",
                    f"{took_s:.1f} s",
                ]
            )
            if kind == "imm":
                assert math.sqrt(np.mean(squares)) <= 2.5
                assert math.sqrt(np.mean(late)) <= 1.5
                assert abs(yaw_deg - 0.4) < min(0.15, 3 * sigma_deg)
    print("\n")
    for row in rows:
        print("| " + " | ".join(row) + " |")

"""The numbers over time that the figures show."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.app.report.history import AircraftTrack, FlightHistory
from sidelong.mission.core.path import FloatArray

_CURVATURE_SPAN_S = 1.0


def curvature_per_m(aircraft: AircraftTrack) -> tuple[FloatArray, FloatArray]:
    """Return times and the curvature of the flown line over the ground, positive to the right, shapes (n,)."""
    turned_rad = np.unwrap(aircraft.course_rad)
    before_s, after_s = aircraft.time_s - _CURVATURE_SPAN_S / 2, aircraft.time_s + _CURVATURE_SPAN_S / 2
    inside = (before_s >= aircraft.time_s[0]) & (after_s <= aircraft.time_s[-1])
    rate_rad_s = (
        np.interp(after_s, aircraft.time_s, turned_rad) - np.interp(before_s, aircraft.time_s, turned_rad)
    ) / _CURVATURE_SPAN_S
    speed_m_s = np.maximum(aircraft.ground_speed_m_s, 1.0)  # on the ground a course is noise
    return aircraft.time_s[inside], (rate_rad_s / speed_m_s)[inside]


@dataclass(frozen=True, slots=True, eq=False)
class EstimateErrors:
    """Arrays of shape (n,). radius95_m is the long half axis of the 95 % ellipse.

    nees: normalised error squared, chi-square with two degrees of freedom where the estimate is consistent.
    """

    time_s: FloatArray
    error_m: FloatArray
    radius95_m: FloatArray
    nees: FloatArray


def estimate_errors(history: FlightHistory) -> EstimateErrors | None:
    """Return the errors where truth and estimate are both known; None without a truth."""
    if history.truth is None:
        return None
    rows = []
    for one in history.estimates:
        true = history.truth.at(one.time_s, history.plane)
        if true is None:
            continue
        miss_m = np.array([one.east_m - true.target_east_m, one.north_m - true.target_north_m])
        nees = float(miss_m @ np.linalg.solve(one.covariance[:2, :2], miss_m))
        rows.append((one.time_s, math.hypot(*miss_m), one.ellipse_95.semi_major_m, nees))
    return EstimateErrors(*np.array(rows).T) if rows else None


def normalised_innovations(history: FlightHistory) -> tuple[FloatArray, FloatArray]:
    """Return times and the NIS of the sightings that were compared (chi-square, 3), accepted or not, shapes (n,)."""
    compared = [(one.sighting.time_s, one.nis) for one in history.sightings if math.isfinite(one.nis)]
    time_s, nis = np.array(compared).reshape(-1, 2).T
    return time_s, nis

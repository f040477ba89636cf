"""The picture of a flight: the path of the aircraft, the path of the target, and where both were when."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from sidelong.app.report.history import FlightHistory
from sidelong.app.report.plot_style import (
    AIRCRAFT,
    BAD,
    CIRCLE,
    ESTIMATE,
    FAINT,
    ROUTE,
    TARGET,
    WIDTH_IN,
    legend_above,
)
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray

_TICK_S = 50.0
_LABELS_MAX = 60
_STAY_SHARE = 0.04  # of the map's extent: labels that near one another would overlap
_SAMPLES_MAX, _ROUTE_POINTS = 6000, 2000
_CONTOUR_POSTS, _CONTOURS_MAX = 200, 25
_CONTOUR_STEPS_M = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)


def flown_path_figure(history: FlightHistory) -> Figure:
    """Return the map: paths with a tick every 50 s, joined by the line of sight; circles flown; fences; contours.

    Make and save it within ``plot_style.styled()``.
    """
    moments = history.moments
    time_s = np.array([m.time_s for m in moments]) - history.start_s
    aircraft = np.array([(m.aircraft_east_m, m.aircraft_north_m) for m in moments]).reshape(-1, 2)
    target = np.array([(m.target_east_m, m.target_north_m) for m in moments]).reshape(-1, 2)
    flown = history.aircraft
    since = flown.time_s >= history.start_s
    path = np.column_stack((flown.east_m[since], flown.north_m[since]))[:: max(1, int(since.sum()) // _SAMPLES_MAX)]

    spread_m = np.ptp(np.concatenate((path, target)), axis=0) + 120.0
    height_in = WIDTH_IN * float(np.clip(spread_m[1] / spread_m[0], 0.45, 0.9)) + 0.6
    made = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = made.subplots()
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.04)
    for outline in history.asked.keep_in:
        axes.add_patch(Polygon(outline, fill=False, edgecolor=BAD, linewidth=1.2, linestyle="--"))
    for outline in history.asked.keep_out:
        axes.add_patch(Polygon(outline, facecolor=BAD, alpha=0.12, edgecolor=BAD, linewidth=1.0))
    if history.route is not None:
        drawn = history.route.outline_m(_ROUTE_POINTS)
        axes.plot(*drawn.T, color=ROUTE, linewidth=6.0, zorder=0, label="route")
    axes.plot(*path.T, color=AIRCRAFT, linewidth=1.0, label="aircraft")
    what = "target" if history.judged_by_truth else "target (estimate)"
    axes.plot(*target.T, color=TARGET, linewidth=3.0, alpha=0.5, label=what)
    if history.judged_by_truth:
        estimate = np.array([(e.east_m, e.north_m) for e in history.estimates if e.time_s >= history.start_s])
        if len(estimate):
            axes.plot(*estimate.T, color=ESTIMATE, linewidth=0.9, label="estimate")
    _circles(axes, [circle for _, circle in history.circles])
    _ticks(axes, time_s, aircraft, target)
    if history.asked.ground is not None:
        _contours(axes, history.asked.ground)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    legend_above(axes)
    return made


def _contours(axes: Axes, ground: Ground) -> None:
    """Draw lines of equal height above home behind all that is drawn already, and as far as the axes may grow."""
    limits_m = axes.get_xlim(), axes.get_ylim()
    reach_m = max(high_m - low_m for low_m, high_m in limits_m)
    x_m, y_m = (np.linspace(-reach_m, reach_m, _CONTOUR_POSTS) + np.mean(axis) for axis in limits_m)
    heights_m = np.ma.masked_invalid(ground.heights_at_m(*np.meshgrid(x_m, y_m)))
    span_m = float(np.ptp(heights_m.compressed())) if heights_m.count() else 0.0
    step_m = next((step_m for step_m in _CONTOUR_STEPS_M if span_m / step_m <= _CONTOURS_MAX), None)
    if span_m <= _CONTOUR_STEPS_M[0] or step_m is None:
        return
    levels_m = np.arange(math.floor(heights_m.min() / step_m), heights_m.max() / step_m) * step_m
    flown = axes.dataLim.frozen()
    drawn = axes.contour(x_m, y_m, heights_m, levels_m, colors=FAINT, linewidths=0.5, alpha=0.7, zorder=0)
    axes.dataLim.set(flown)
    axes.autoscale_view(tight=False)
    axes.apply_aspect()  # labels are as long as the picture's scale makes them
    axes.clabel(drawn, fmt="%g m", fontsize=7, inline_spacing=2)


def _circles(axes: Axes, circles: list[Circle]) -> None:
    around_rad = np.linspace(0.0, 2.0 * np.pi, 61)
    for number, circle in enumerate(circles):
        axes.plot(
            circle.east_m + circle.radius_m * np.sin(around_rad),
            circle.north_m + circle.radius_m * np.cos(around_rad),
            color=CIRCLE,
            linewidth=0.7,
            zorder=1,
            label="circle commanded" if number == 0 else None,
        )


def _ticks(axes: Axes, time_s: FloatArray, aircraft: FloatArray, target: FloatArray) -> None:
    if not len(time_s):
        return
    at_s = np.arange(0.0, time_s[-1] + 1e-9, _TICK_S)
    here_m, there_m = (
        np.column_stack([np.interp(at_s, time_s, track[:, axis]) for axis in (0, 1)]) for track in (aircraft, target)
    )
    axes.plot(*np.stack((here_m, there_m)).transpose(2, 0, 1), color=FAINT, linewidth=0.4, alpha=0.6, zorder=1)
    axes.plot(*here_m.T, "o", color=AIRCRAFT, markersize=3.2)
    axes.plot(*there_m.T, "o", color=TARGET, markersize=3.8)
    near_m = _STAY_SHARE * float(np.ptp(np.concatenate((aircraft, target)), axis=0).max())
    for stay in _stays(there_m, near_m)[:: max(1, len(at_s) // _LABELS_MAX)]:
        first, last = stay[0], stay[-1]
        there = there_m[first]
        away = there - here_m[first]
        away_pt = 7.0 * away / max(float(np.hypot(*away)), 1.0)
        axes.annotate(
            f"{at_s[first]:.0f} s" if first == last else f"{at_s[first]:.0f} to {at_s[last]:.0f} s",
            (there[0], there[1]),
            xytext=(away_pt[0], away_pt[1]),
            textcoords="offset points",
            ha="left" if away_pt[0] > 0.0 else "right",
            va="center",
            fontsize=8,
            color=TARGET,
            bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.6},
        )


def _stays(target_m: FloatArray, near_m: float) -> list[range]:
    """Return the ticks in runs of which all lie where the first does: a target that stands gets one label."""
    stays: list[range] = []
    for number, place_m in enumerate(target_m):
        if stays and np.hypot(*(place_m - target_m[stays[-1][0]])) < near_m:
            stays[-1] = range(stays[-1][0], number + 1)
        else:
            stays.append(range(number, number + 1))
    return stays

"""The figures of a report. Times are seconds since watching began; angles in degrees, here at the edge."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import FuncFormatter
from scipy.stats import chi2

from sidelong.app.analysis.score import Samples
from sidelong.app.report import series
from sidelong.app.report.history import FlightHistory, clock
from sidelong.app.report.html import Drawing
from sidelong.app.report.plot_style import (
    AIRCRAFT,
    BAD,
    BAND,
    CIRCLE,
    ESTIMATE,
    FAINT,
    ROUTE,
    TARGET,
    WIDTH_IN,
    figure,
    legend_above,
)
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray

_TICK_S = 50.0
_LABELS_MAX = 12
_BY_TIME = "viridis_r"
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
    passed_s = flown.time_s[since][:: max(1, int(since.sum()) // _SAMPLES_MAX)] - history.start_s
    what = "target" if history.judged_by_truth else "target (estimate)"
    axes.plot(*target.T, color=TARGET, linewidth=3.0, alpha=0.5, label=what)
    _coloured(made, axes, path, passed_s)
    if history.judged_by_truth:
        estimate = np.array([(e.east_m, e.north_m) for e in history.estimates if e.time_s >= history.start_s])
        if len(estimate):
            axes.plot(*estimate.T, color=ESTIMATE, linewidth=0.9, label="estimate")
    _circles(axes, [circle for _, circle in history.circles])
    _ticks(axes, time_s, aircraft, target)
    _numbers(axes, history)
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


def _coloured(made: Figure, axes: Axes, path: FloatArray, time_s: FloatArray) -> None:
    """Draw the aircraft's path in the colour of its time since watching began."""
    if len(path) < 2:
        return
    lines = LineCollection(np.stack((path[:-1], path[1:]), axis=1).tolist(), cmap=_BY_TIME, linewidths=1.2)
    lines.set_array(time_s[:-1])
    axes.add_collection(lines)
    axes.update_datalim(path)
    bar = made.colorbar(lines, ax=axes, shrink=0.6, aspect=30, label="aircraft: time since watching began")
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: clock(value)))


def _numbers(axes: Axes, history: FlightHistory) -> None:
    """Draw the number of each decision to move where the aircraft was, as the table of decisions has it."""
    flown = history.aircraft
    if not len(flown.time_s):
        return
    for number, one in enumerate(history.moves, 1):
        at = tuple(float(np.interp(one.time_s, flown.time_s, line)) for line in (flown.east_m, flown.north_m))
        box = {"boxstyle": "circle,pad=0.2", "facecolor": "white", "edgecolor": AIRCRAFT, "linewidth": 0.8}
        axes.annotate(str(number), (at[0], at[1]), ha="center", va="center", fontsize=7, color=AIRCRAFT, bbox=box)


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
            clock(at_s[first]) if first == last else f"{clock(at_s[first])} to {clock(at_s[last])}",
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


_COURSE_WORDS = (
    "Over the ground, in whole turns counted on clockwise from north: it rises while the aircraft circles to the "
    "right, falls while it circles to the left, and stands while it flies straight."
)
_TIME = "time since watching began, min:s"
_BIN_DEG = 10.0
_CONSISTENCY_TOP = 2.0  # of the bound: what lies above is drawn at the edge
_POINTS_MAX = 2000  # more are drawn as an image inside the figure


def drawings(history: FlightHistory) -> Iterator[Drawing]:
    """Yield the figures in order, those left out that nothing is known for. Use within ``plot_style.styled()``."""
    watched = _map, _range, _observation, _observation_histogram
    flown = _curvature, _course, _target_speed, _route
    makers: tuple[Callable[[FlightHistory], Drawing | None], ...] = *watched, *flown, _errors, _consistency, _uploads
    yield from filter(None, (make(history) for make in makers))


# -- where ---------------------------------------------------------------------------------------------------


def _map(history: FlightHistory) -> Drawing:
    return Drawing(
        "path",
        "Paths over the ground",
        "Aircraft, in the colour of its time, and target with a dot every 50 s, joined by the line of sight; circles "
        "as they were commanded. The numbers are those of the decisions below.",
        flown_path_figure(history),
    )


# -- how the target was watched ------------------------------------------------------------------------------


def _range(history: FlightHistory) -> Drawing:
    requirement, judged = history.requirement, history.judged
    made, (axes,) = figure(2.9)
    axes.axhspan(requirement.range_min_m, requirement.range_max_m, color=BAND, lw=0, label="allowed band")
    axes.plot(judged.time_s - history.start_s, judged.range_m, color=AIRCRAFT, linewidth=1.1, label=_judged(history))
    min_m, max_m = float(judged.range_m.min(initial=math.inf)), float(judged.range_m.max(initial=0.0))
    axes.set_ylim(0.0, 1.06 * max(requirement.range_max_m, max_m))
    _over_time(axes, history, "horizontal range, m")
    asked = f"allowed are {requirement.range_min_m:.0f} to {requirement.range_max_m:.0f} m."
    return Drawing("range", "Range to the target", f"Between {min_m:.0f} and {max_m:.0f} m; {asked}", made)


def _observation(history: FlightHistory) -> Drawing:
    made, (axes,) = figure(2.9)
    allowed_deg = math.degrees(history.requirement.allowed_rad)
    axes.axhspan(-allowed_deg, allowed_deg, color=BAND, lw=0, label=_wanted(history))
    line = _unjoined(history.judged.time_s - history.start_s, np.degrees(history.judged.observation_rad), 180.0)
    axes.plot(*line, color=AIRCRAFT, linewidth=1.0, label=_judged(history))
    axes.set(ylim=(-180.0, 180.0), yticks=range(-180, 181, 60))
    _over_time(axes, history, "observation angle, °")
    caption = (
        "Where the aircraft is, seen from the target: 0° is the middle of the sector asked for."
        if history.requirement.sector is not None
        else "From the normal of the target's motion, on the side asked for, to the line of sight: 0° is abeam; "
        "beyond ±90° the aircraft is on the other side."
    )
    return Drawing("observation-angle", "Observation angle", caption, made)


def _observation_histogram(history: FlightHistory) -> Drawing | None:
    angle_deg = np.degrees(history.judged.observation_rad)
    angle_deg = angle_deg[np.isfinite(angle_deg)]
    if not len(angle_deg):
        return None
    made, (axes,) = figure(2.9)
    bins = np.arange(-180.0, 180.0 + _BIN_DEG, _BIN_DEG).tolist()
    allowed_deg = math.degrees(history.requirement.allowed_rad)
    axes.axvspan(-allowed_deg, allowed_deg, color=BAND, lw=0, label=_wanted(history))
    shares = np.full(len(angle_deg), 100.0 / len(angle_deg))
    axes.hist(angle_deg, bins, weights=shares, color=AIRCRAFT, rwidth=0.9)
    axes.set(xlim=(-180.0, 180.0), xticks=range(-180, 181, 30))
    axes.set(xlabel="observation angle, °", ylabel="share of time, %")
    legend_above(axes)
    share = 100.0 * float(np.mean(np.abs(angle_deg) <= allowed_deg))
    caption = f"{share:.1f} % of the known time the aircraft was where it was asked to be."
    return Drawing("observation-histogram", "How often from which angle", caption, made)


# -- how the aircraft flew -----------------------------------------------------------------------------------


def _curvature(history: FlightHistory) -> Drawing:
    made, (axes,) = figure(2.7)
    time_s, curvature_per_m = series.curvature_per_m(history.aircraft)
    axes.plot(time_s - history.start_s, 1e3 * curvature_per_m, color=AIRCRAFT, linewidth=0.9, label="flown")
    radius_m = history.asked.airframe.radius_m
    for sign, label in ((1.0, f"circle of {radius_m:.0f} m"), (-1.0, None)):
        axes.axhline(sign * 1e3 / radius_m, color=FAINT, linestyle="--", linewidth=0.8, label=label)
    reach = 1.6e3 / radius_m
    axes.set_ylim(-reach, reach)
    clipped = _beyond(1e3 * np.abs(curvature_per_m), reach, " 1/km")
    _over_time(axes, history, "curvature, 1/km")
    caption = f"Over the ground; positive turns right{clipped}."
    return Drawing("curvature", "Curvature of the flown path", caption, made)


def _course(history: FlightHistory) -> Drawing:
    made, (axes,) = figure(2.7)
    turns = np.unwrap(history.aircraft.course_rad) / math.tau
    axes.plot(history.aircraft.time_s - history.start_s, turns, color=AIRCRAFT, linewidth=0.9, label="flown")
    _over_time(axes, history, "course flown, turns")
    return Drawing("course", "Course flown", _COURSE_WORDS, made)


def _target_speed(history: FlightHistory) -> Drawing:
    made, (axes,) = figure(2.7)
    if history.judged_by_truth:
        true = Samples.of(history.moments)
        time_s, speed_m_s = true.time_s - history.start_s, np.hypot(*true.target_velocity_m_s.T)
        axes.plot(time_s, speed_m_s, color=TARGET, linewidth=2.4, alpha=0.5, label="true target")
    known = [(one.time_s - history.start_s, one.speed_m_s) for one in history.estimates]
    line = [one for one in known if one[0] >= 0.0]
    axes.plot(*np.array(line).reshape(-1, 2).T, color=ESTIMATE, linewidth=0.9, label="estimate")
    axes.set_ylim(0.0, None)
    _over_time(axes, history, "target's speed, m/s")
    return Drawing("target-speed", "Speed of the target", "Over the ground.", made)


def _route(history: FlightHistory) -> Drawing | None:
    progress = [(time_s, one) for time_s, one in history.progress if time_s >= history.start_s]
    if not progress:
        return None
    made, (axes,) = figure(2.7)
    time_s = np.array([at_s for at_s, _ in progress]) - history.start_s
    along_m = np.array([one.along_m for _, one in progress])
    off, length_m = ~np.isfinite(along_m), progress[-1][1].route.length_m
    unused = ~off & ~np.array([one.of_use for _, one in progress])
    for where, colour, label in ((off, FAINT, "off route"), (unused, BAD, "not used")):
        axes.fill_between(time_s, 0.0, length_m, where=where.tolist(), color=colour, alpha=0.25, lw=0, label=label)
    axes.plot(*_unjoined(time_s, along_m, 0.5 * length_m), color=TARGET, linewidth=1.2, label="target (estimate)")
    axes.set_ylim(0.0, length_m)
    _over_time(axes, history, "along the route, m")
    on, not_used = (100.0 * float(np.mean(one)) for one in (~off, unused))
    reason = f", {not_used:.1f} % not used: straight on predicts the target better" if not_used else ""
    caption = f"On the route {on:.1f} % of the time{reason}; its length is {length_m:.0f} m."
    return Drawing("route", "Progress along the route", caption, made)


# -- how good the estimate was -------------------------------------------------------------------------------


def _errors(history: FlightHistory) -> Drawing | None:
    errors = series.estimate_errors(history)
    if errors is None:
        return None
    made, (axes,) = figure(2.7)
    time_s = errors.time_s - history.start_s
    axes.plot(time_s, errors.error_m, color=ESTIMATE, linewidth=1.0, label="error")
    claimed = "long half axis of the 95 % ellipse"
    axes.plot(time_s, errors.radius95_m, color=FAINT, linewidth=0.9, linestyle="--", label=claimed)
    watched = errors.error_m[time_s >= 0.0]
    claimed_m = float(np.percentile(errors.radius95_m, 90.0))
    top_m = 1.2 * max(claimed_m, float(np.percentile(np.append(watched, 1.0), 99.8)))
    axes.set_ylim(0.0, top_m)
    clipped = _beyond(np.append(errors.error_m, errors.radius95_m), top_m, " m")
    _over_time(axes, history, "position error, m")
    return Drawing(
        "estimate-error",
        "Error of the estimate",
        f"Horizontal distance from the true target, once a second, compared with what the estimate claims{clipped}.",
        made,
    )


def _consistency(history: FlightHistory) -> Drawing | None:
    at_s, nis = series.normalised_innovations(history)
    errors = series.estimate_errors(history)
    rows: list[tuple[str, FloatArray, FloatArray, int]] = []
    if errors is not None:
        rows.append(("NEES", errors.time_s, errors.nees, 2))
    if len(nis):
        rows.append(("NIS", at_s, nis, 3))
    if not rows:
        return None
    made, all_axes = figure(1.2 + 1.7 * len(rows), len(rows))
    words, clipped = [], ""
    for axes, (name, at_s, value, freedom) in zip(all_axes, rows, strict=True):
        bound = float(chi2.ppf(0.95, freedom))
        top = _CONSISTENCY_TOP * bound
        time_s, many = at_s - history.start_s, len(value) > _POINTS_MAX
        axes.plot(time_s, np.minimum(value, top), ".", color=ESTIMATE, markersize=1.6, rasterized=many)
        axes.axhline(bound, color=BAD, linewidth=0.9, linestyle="--", label=f"95 % of chi-square ({freedom})")
        axes.set(ylim=(0.0, top), ylabel=name)
        legend_above(axes)
        clipped += _beyond(value, top, f", drawn at the edge of {name}")
        words.append(f"{100.0 * float(np.mean(value[at_s >= history.start_s] <= bound)):.1f} % of the {name}")
    all_axes[-1].set(xlabel=_TIME, xlim=(0.0, history.end_s - history.start_s))
    all_axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: clock(value)))
    meanings = {
        "NEES": "NEES: error against the truth over its claimed covariance, squared",
        "NIS": "NIS: innovation of each sighting, squared",
    }
    explained = "; ".join(meanings[name] for name, *_ in rows)
    caption = f"{' and '.join(words)} below the bound that 95 % should keep ({explained}){clipped}."
    return Drawing("consistency", "Consistency of the estimate", caption, made)


# -- how the plans got there ---------------------------------------------------------------------------------


def _uploads(history: FlightHistory) -> Drawing | None:
    if not history.plan_changes:
        return None
    made, (took, waited) = figure(3.8, 2)
    start_s, changes = history.start_s, history.plan_changes
    ready = [(one.prepared_s - start_s, one.ready_s - one.prepared_s) for one in changes if one.ready_s is not None]
    left = [(one.departed_s, one.plan.departure_s) for one in changes if one.departed_s is not None]
    departed = [(at_s - start_s, at_s - planned_s) for at_s, planned_s in left]
    failed = [one.prepared_s - start_s for one in changes if one.failed]
    for axes, points in ((took, ready), (waited, departed)):
        at_s, value_s = np.array(points).reshape(-1, 2).T
        axes.vlines(at_s, 0.0, value_s, color=TARGET, linewidth=1.0)
        axes.plot(at_s, value_s, "o", color=TARGET, markersize=3.5)
        axes.axhline(0.0, color=FAINT, linewidth=0.7)
    if failed:
        took.plot(failed, np.zeros(len(failed)), "x", color=BAD, markersize=6, label="failed", clip_on=False)
        legend_above(took)
    took.set_ylim(0.0, None)
    took.set_ylabel("upload took, s")
    waited.set(ylabel="left after plan, s", xlabel=_TIME, xlim=(0.0, history.end_s - start_s))
    waited.xaxis.set_major_formatter(FuncFormatter(lambda value, _: clock(value)))
    slowest_s = f", the slowest took {max(value for _, value in ready):.2f} s" if ready else ""
    return Drawing(
        "uploads",
        "Uploads",
        f"{len(changes)} plans were sent{slowest_s}; {len(departed)} were flown, {len(failed)} failed. "
        "Below: how much later than planned the aircraft was commanded to leave its circle.",
        made,
    )


def _beyond(value: FloatArray, limit: float, unit: str) -> str:
    """Return in words what does not fit the frame, '' where all does."""
    above = int(np.sum(value > limit))
    if not above:
        return ""
    return f"; {100.0 * above / len(value):.1f} % lie beyond the frame, up to {float(np.nanmax(value)):.0f}{unit}"


def _wanted(history: FlightHistory) -> str:
    requirement = history.requirement
    if requirement.sector is not None:
        return "sector asked for"
    return "either side" if requirement.either_side else f"{requirement.side} side"


def _judged(history: FlightHistory) -> str:
    return "by the true target" if history.judged_by_truth else "by the estimate"


def _over_time(axes: Axes, history: FlightHistory, label: str) -> None:
    axes.set(xlim=(0.0, history.end_s - history.start_s), xlabel=_TIME, ylabel=label)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: clock(value)))
    departed_s = [change.departed_s for change in history.plan_changes if change.departed_s is not None]
    for number, at_s in enumerate(departed_s):
        word = "leaves its circle" if number == 0 else None
        axes.axvline(at_s - history.start_s, color=FAINT, linewidth=0.7, linestyle=":", zorder=1, label=word)
    legend_above(axes)


def _unjoined(time_s: FloatArray, angle_deg: FloatArray, jump_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return the line with a gap wherever the angle wraps around."""
    wraps = np.flatnonzero(np.abs(np.diff(angle_deg)) > jump_deg) + 1
    return np.insert(time_s, wraps, np.nan), np.insert(angle_deg, wraps, np.nan)

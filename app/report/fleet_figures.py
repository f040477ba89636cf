"""The figures about several aircraft. Times are seconds of mission time since all were watching."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.analysis.fleet_summary import judged_together, min_separation_m
from app.report import series
from app.report.fleet_flown import AircraftPart, FleetFlown
from app.report.history import FloatArray
from app.report.html import Drawing
from app.report.plot_style import BAD, BAND, TARGET, WIDTH_IN, figure, legend_above
from mission.core.fleet import Role
from mission.geometry.separation import MIN_SEPARATION_M

_COLOURS = ("#1f5f9e", "#2c8f5a", "#8a5fa8", "#b08a1e", "#c0527f", "#3f9fb5", "#6b6b6b", "#9a5a2c")
_ANY = "#7fb98a"
_STEP_S = 0.5
_TIME = "time, s"


def fleet_drawings(flown: FleetFlown) -> Iterator[Drawing]:
    """Yield the figures in order. Use within ``plot_style.styled()``."""
    yield _paths(flown)
    yield _sides(flown)
    yield _ranges(flown)
    if len(flown.aircraft) > 1:
        yield _separation(flown)


def _coloured(flown: FleetFlown) -> Iterator[tuple[AircraftPart, str]]:
    for k, one in enumerate(flown.aircraft):
        yield one, _COLOURS[k % len(_COLOURS)]


def start_s(flown: FleetFlown) -> float:
    """Return when all were watching."""
    return max(one.flown.history.start_s + one.offset_s for one in flown.aircraft)


def _end_s(flown: FleetFlown) -> float:
    return max(one.flown.history.end_s + one.offset_s for one in flown.aircraft)


def _paths(flown: FleetFlown) -> Drawing:
    begin_s = start_s(flown)
    made = Figure(figsize=(WIDTH_IN, 0.75 * WIDTH_IN), layout="constrained")
    axes = made.subplots()
    axes.set_aspect("equal", adjustable="datalim")
    for one, colour in _coloured(flown):
        aircraft = one.flown.history.aircraft
        since = aircraft.time_s + one.offset_s >= begin_s
        axes.plot(aircraft.east_m[since], aircraft.north_m[since], color=colour, linewidth=0.9, label=one.name)
    longest = max(flown.aircraft, key=lambda one: len(one.flown.history.moments)).flown.history
    target = np.array([(m.target_east_m, m.target_north_m) for m in longest.moments]).reshape(-1, 2)
    what = "target" if longest.judged_by_truth else "target (estimate)"
    axes.plot(*target.T, color=TARGET, linewidth=3.0, alpha=0.5, label=what)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    legend_above(axes)
    return Drawing("paths", "Paths over the ground", "All aircraft and the target, since all were watching.", made)


def _sides(flown: FleetFlown) -> Drawing:
    """Draw when each aircraft was on the wanted side and in the band, and was to be; on top when any was."""
    begin_s, end_s = start_s(flown), _end_s(flown)
    times_s = np.arange(begin_s, end_s, _STEP_S)
    any_kept = np.zeros(len(times_s), bool)
    made, (axes,) = figure(1.0 + 0.55 * (1 + len(flown.aircraft)))
    for row, (one, colour) in enumerate(_coloured(flown)):
        kept = np.zeros(len(times_s), bool)
        for moment in judged_together(one.flown.history.moments, flown.asked, one.offset_s):
            k = round((moment.time_s - begin_s) / _STEP_S)
            if 0 <= k < len(kept):
                kept[k : k + 2] = moment.on_side and moment.in_band
        any_kept |= kept
        _bars(axes, row, times_s - begin_s, kept, colour)
        edges_s = [since_s for since_s, _ in one.roles] + [end_s]
        for (since_s, role), until_s in zip(one.roles, edges_s[1:], strict=True):
            if role is Role.WANTED:
                axes.broken_barh([(since_s - begin_s, until_s - since_s)], (row - 0.42, 0.1), color=colour)
    top = len(flown.aircraft)
    _bars(axes, top, times_s - begin_s, any_kept, _ANY)
    _bars(axes, top, times_s - begin_s, ~any_kept, BAD)
    axes.set_yticks(range(top + 1), [*(one.name for one in flown.aircraft), "any of them"])
    axes.set_ylim(-0.5, top + 0.6)
    axes.set_xlim(0.0, end_s - begin_s)
    axes.set_xlabel(_TIME)
    axes.grid(visible=False, axis="y")
    return Drawing(
        "sides",
        "Who watched from the wanted side",
        "Bars: on the wanted side and in the band; red where none of them was. The line below a bar is where the "
        "coordinator wanted that aircraft on that side.",
        made,
    )


def _bars(axes: Axes, row: int, time_s: FloatArray, held: np.ndarray, colour: str) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], held.astype(np.int8), [0]))))
    spans = [(time_s[a], _STEP_S * (b - a)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    axes.broken_barh(spans, (row - 0.25, 0.5), color=colour, linewidth=0)


def _ranges(flown: FleetFlown) -> Drawing:
    (_, asked), begin_s = flown.asked[0], start_s(flown)
    made, (axes,) = figure(2.9)
    axes.axhspan(asked.range_min_m, asked.range_max_m, color=BAND, lw=0, label="allowed band")
    for one, colour in _coloured(flown):
        seen = series.range_m(one.flown.history.moments)
        axes.plot(seen.time_s + one.offset_s - begin_s, seen.value, color=colour, linewidth=1.0, label=one.name)
    axes.set_xlim(0.0, _end_s(flown) - begin_s)
    axes.set_ylim(0.0, 1.3 * asked.range_max_m)
    axes.set_xlabel(_TIME)
    axes.set_ylabel("horizontal range, m")
    legend_above(axes)
    return Drawing("ranges", "Range to the target", "Of each aircraft, over the ground.", made)


def _separation(flown: FleetFlown) -> Drawing:
    begin_s = start_s(flown)
    airborne_s = min(one.track.rows[0][0] for one in flown.aircraft if one.track.rows)
    times_s = np.arange(airborne_s, _end_s(flown), _STEP_S)
    places = [one.track.at(times_s) for one in flown.aircraft]
    apart_m = [np.linalg.norm(one - other, axis=1) for one, other in combinations(places, 2)]
    nearest_m = np.fmin.reduce(apart_m)
    made, (axes, heights) = figure(4.0, 2)
    axes.plot(times_s - begin_s, nearest_m, color=_COLOURS[0], linewidth=1.0)
    axes.axhline(MIN_SEPARATION_M, color=BAD, linewidth=0.9, linestyle="--", label=f"{MIN_SEPARATION_M:.0f} m")
    axes.set_ylim(0.0, None)
    axes.set_ylabel("least distance, m")
    legend_above(axes)
    for (one, colour), place in zip(_coloured(flown), places, strict=True):
        heights.plot(times_s - begin_s, place[:, 2], color=colour, linewidth=1.0, label=one.name)
    heights.set_ylabel("height, m")
    heights.set_xlabel(_TIME)
    legend_above(heights)
    least_m = min_separation_m([one.track for one in flown.aircraft])
    told = (
        "No two were in the air at once." if least_m is None else f"Never nearer than {least_m:.0f} m to each other"
    )
    return Drawing(
        "separation", "How far apart", f"{told}, in three dimensions; heights above the common home.", made
    )

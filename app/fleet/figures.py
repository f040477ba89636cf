"""The figures about several aircraft. Times are seconds of mission time since all were watching."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sidelong.app.analysis.score import Moment
from sidelong.app.fleet.flown import AircraftPart, FleetFlown
from sidelong.app.fleet.summary import judged_by_target, min_separation_m
from sidelong.app.report import series
from sidelong.app.report.history import FloatArray
from sidelong.app.report.html import Drawing
from sidelong.app.report.plot_style import BAD, BAND, TARGET, WIDTH_IN, figure, legend_above
from sidelong.mission.core.fleet import Role
from sidelong.mission.geometry.separation import MIN_SEPARATION_M

_COLOURS = ("#1f5f9e", "#2c8f5a", "#8a5fa8", "#b08a1e", "#c0527f", "#3f9fb5", "#6b6b6b", "#9a5a2c")
_ANY = "#7fb98a"
_TARGETS = (TARGET, "#6b5a00", "#8a1e5a", "#1e6b6b")
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
    for name, colour in zip(flown.asked, _TARGETS, strict=False):
        moments, by_truth = _seen_longest(flown, name)
        target = np.array([(m.target_east_m, m.target_north_m) for m in moments]).reshape(-1, 2)
        what = name if by_truth else f"{name} (estimate)"
        axes.plot(*target.T, color=colour, linewidth=3.0, alpha=0.5, label=what)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    legend_above(axes)
    return Drawing("paths", "Paths over the ground", "All aircraft and what they watched, since all did.", made)


def _seen_longest(flown: FleetFlown, target: str) -> tuple[list[Moment], bool]:
    """Return the moments of the aircraft that saw a target longest, and whether they are the truth's."""
    first = next(iter(flown.asked))
    seen = [
        ([one for one in part.flown.history.moments if (one.target or first) == target], part.flown.history)
        for part in flown.aircraft
    ]
    moments, history = max(seen, key=lambda one: len(one[0]))
    return moments, history.judged_by_truth


def _sides(flown: FleetFlown) -> Drawing:
    """Draw when each aircraft was on the required side and in the band, and was assigned; on top when any was."""
    begin_s, end_s = start_s(flown), _end_s(flown)
    times_s = np.arange(begin_s, end_s, _STEP_S)
    any_kept = {name: np.zeros(len(times_s), bool) for name in flown.asked}
    rows = len(flown.aircraft) + len(any_kept)
    made, (axes,) = figure(1.0 + 0.55 * rows)
    for row, (one, colour) in enumerate(_coloured(flown)):
        kept = {name: np.zeros(len(times_s), bool) for name in flown.asked}
        for name, judged in judged_by_target(one.flown.history.moments, flown.asked, one.offset_s).items():
            steps = np.rint((judged.time_s - begin_s) / _STEP_S).astype(int)
            for k, held in zip(steps.tolist(), (judged.on_side & judged.in_band).tolist(), strict=True):
                if 0 <= k < len(times_s):
                    kept[name][k : k + 2] = held
            any_kept[name] |= kept[name]
        _bars(axes, row, times_s - begin_s, np.logical_or.reduce(list(kept.values())), colour)
        edges_s = [since_s for since_s, _, _ in one.roles] + [end_s]
        for (since_s, role, _), until_s in zip(one.roles, edges_s[1:], strict=True):
            if role is Role.WANTED:
                axes.broken_barh([(since_s - begin_s, until_s - since_s)], (row - 0.42, 0.1), color=colour)
    for row, held in enumerate(any_kept.values(), len(flown.aircraft)):
        _bars(axes, row, times_s - begin_s, held, _ANY)
        _bars(axes, row, times_s - begin_s, ~held, BAD)
    any_names = [f"{name}, by any" if len(any_kept) > 1 else "any of them" for name in any_kept]
    axes.set_yticks(range(rows), [*(one.name for one in flown.aircraft), *any_names])
    axes.set_ylim(-0.5, rows - 0.4)
    axes.set_xlim(0.0, end_s - begin_s)
    axes.set_xlabel(_TIME)
    axes.grid(visible=False, axis="y")
    return Drawing(
        "sides",
        "Who watched from the wanted side",
        "Bars: on the wanted side and in the band; red where none of them was. The line below a bar is where the "
        "coordinator wanted that aircraft on that side. The shares above are of the time since all were in the band.",
        made,
    )


def _bars(axes: Axes, row: int, time_s: FloatArray, held: np.ndarray, colour: str) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], held.astype(np.int8), [0]))))
    spans = [(time_s[a], _STEP_S * (b - a)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    axes.broken_barh(spans, (row - 0.25, 0.5), color=colour, linewidth=0)


def _ranges(flown: FleetFlown) -> Drawing:
    (_, asked), begin_s = next(iter(flown.asked.values()))[0], start_s(flown)
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
    return Drawing("ranges", "Range to the target", "Of each aircraft to what it watches, over the ground.", made)


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

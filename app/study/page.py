"""A study on one page: the designs, how the runs spread, maps over what was swept, the worst runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from sidelong.app.records.text_file import write_text
from sidelong.app.report import html
from sidelong.app.report.plot_style import BAD, figure, legend_above, styled
from sidelong.app.study.design import word
from sidelong.app.study.measures import BAND, EXPLAINED, MOVES, SIDE, Measure
from sidelong.app.study.report import measures_of, study_parts, study_title, sweep_rows
from sidelong.app.study.study import StudyResult, flown_again

_BINS, _WORST = 40, 4
_SPREAD_RUNS = 10  # of fewer runs a histogram shows nothing
_TABLED = 200  # rows


def write_page(results: Sequence[StudyResult], command: str, again: str, file: Path) -> None:
    """Write the page.

    Args:
        results: Those of each design.
        command: What was given.
        again: The same without what was swept, which flies one run again.
        file: The page's file.

    Raises:
        OSError: It cannot be written.
    """
    first = results[0]
    title = study_title(first) if len(results) == 1 else f"{len(results)} designs"
    with styled():
        # The design whose first planner is on the side longest.
        best = max(results, key=lambda one: _mean(next(iter(one.planners.values()))[SIDE.name], SIDE))
        figures = [*_maps(results), *_spreads(best)]
        parts = [_table(results), *map(html.figure, figures), *_worst(results, again)]
    head = f"<h1>Study</h1><p>{escape(title)}; {escape(study_parts(first.settings))}.</p>"
    whole = [head, f"<p><code>{escape(command)}</code></p>", *parts]
    write_text(file, html.document("sidelong study", "\n".join(whole)))


def _table(results: Sequence[StudyResult]) -> str:
    headings, *rows = sweep_rows(results)
    more = len(rows) - _TABLED
    left_out = f"<p>{more} more rows are not shown; --export writes all runs.</p>" if more > 0 else ""
    return f"{html.table(headings, rows[:_TABLED], 'Designs')}<p>{EXPLAINED}</p>{left_out}"


def _mean(values: np.ndarray, of: Measure) -> float:
    return of.spread(of.shown(values))["mean"] or 0.0


def _spreads(result: StudyResult) -> Iterator[html.Drawing]:
    whose = f"Of the design that is on the side longest: {result.design}. " if result.design.swept else ""
    for k, of in enumerate(measures_of(result.settings)):
        known = {name: of.shown(planner[of.name]) for name, planner in result.planners.items()}
        everything = np.concatenate(list(known.values()))
        if everything.size < _SPREAD_RUNS or np.ptp(everything) == 0.0:
            continue  # the table states all there is
        drawn, (axes,) = figure(2.4)
        edges = np.histogram_bin_edges(everything, _BINS)
        for name, values in known.items():
            axes.stairs(np.histogram(values, edges)[0], edges, label=str(name))
        axes.set(xlabel=of.label, ylabel="runs")
        legend_above(axes)
        yield html.Drawing(f"spread-{k}", of.label.capitalize(), f"{whose}How the runs spread.", drawn)


def _maps(results: Sequence[StudyResult]) -> Iterator[html.Drawing]:
    """Draw the means over the first swept parameter and, where two were swept, over the second one upwards."""
    swept = [dict(one.design.swept) for one in results]
    varied = [key for key in swept[0] if len({values[key] for values in swept}) > 1][:2]
    for k, of in enumerate((SIDE, BAND, MOVES) if varied else ()):
        for planner in results[0].planners:
            yield _map(f"map-{k}-{planner}", planner, of, varied, results)


def _map(name: str, planner: str, of: Measure, keys: Sequence[str], results: Sequence[StudyResult]) -> html.Drawing:
    across_key, up_key = (*keys, "")[:2]
    swept = [{"": "", **dict(one.design.swept)} for one in results]
    across, up = (list(dict.fromkeys(values[key] for values in swept)) for key in (across_key, up_key))
    sums, counts = np.zeros((len(up), len(across))), np.zeros((len(up), len(across)))
    for values, result in zip(swept, results, strict=True):
        place = up.index(values[up_key]), across.index(values[across_key])
        sums[place] += _mean(result.planners[planner][of.name], of)
        counts[place] += 1
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    drawn, (axes,) = figure(1.6 + 0.3 * len(up))
    axes.grid(visible=False)
    image = axes.imshow(means, origin="lower", aspect="auto", cmap="viridis")
    axes.set(xlabel=across_key, ylabel=up_key)
    axes.set_xticks(range(len(across)), map(word, across))
    axes.set_yticks(range(len(up)), map(word, up))
    middle = np.nanmean([np.nanmin(means), np.nanmax(means)])
    for (row, column), value in np.ndenumerate(means if means.size <= 120 else np.empty((0, 0))):
        if np.isfinite(value):
            colour = "black" if value > middle else "white"
            axes.text(column, row, f"{value:.1f}", ha="center", va="center", color=colour, fontsize=8)
    drawn.colorbar(image, ax=axes, label=of.label)
    others = " Mean over what else was swept." if counts.max() > 1 else ""
    return html.Drawing(name, f"{planner}: {of.label}", f"Mean of the runs; empty: cannot be flown.{others}", drawn)


def _worst(results: Sequence[StudyResult], command: str) -> Iterator[str]:
    """Draw the runs that were on the side shortest of the first planner, and show how to fly each again."""
    found = []
    for result in results:
        planner = next(iter(result.planners.values()))
        sides = zip(planner[SIDE.name].tolist(), planner.runs, strict=True)
        found += [(share, run, result.design) for share, run in sides if math.isfinite(share)]
    found.sort(key=lambda one: one[0])
    for k, (share, run, design) in enumerate(found[:_WORST]):
        drawn, (axes,) = figure(4.2)
        track = flown_again(run, design.settings)
        axes.plot(*track.aircraft_m.T, linewidth=0.8, label="aircraft")
        axes.plot(*track.target_m.T, "k", linewidth=2.0, label="target")
        axes.plot(*track.aircraft_m[~track.judged.on_side].T, ".", color=BAD, markersize=2.0, label="off the side")
        axes.set(xlabel="east, m", ylabel="north, m")
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        swept = "".join(f" --sweep {key}={word(value)}" for key, value in design.swept)
        again = f"{command}{swept} --planner {run.planner} --run {run.number} --report run.html"
        title = f"Run {run.number}: {run.target}, on the side {100.0 * share:.1f} %"
        yield html.figure(html.Drawing(f"worst-{k}", title, "One of the worst runs; fly it again with", drawn))
        yield f"<p><code>{escape(again)}</code></p>"

"""A study on one page: the designs, how the runs spread, maps over what was swept, the worst runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from sidelong.app.records.text_file import write_text
from sidelong.app.report import html
from sidelong.app.report.html import Axis, Chart, Drawing
from sidelong.app.study.design import word
from sidelong.app.study.measures import BAND, EXPLAINED, MOVES, SIDE, Measure
from sidelong.app.study.report import measures_of, study_parts, study_title, sweep_rows
from sidelong.app.study.study import StudyResult, flown_again

_BINS, _WORST = 40, 4
_SPREAD_RUNS = 10  # of fewer runs a histogram shows nothing
_TABLED = 200  # rows
_COLOURS = ("aircraft", "target", "estimate", "third", "fourth", "bad", "circle", "faint")  # of planners


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
    # The design whose first planner is on the side longest.
    best = max(results, key=lambda one: _mean(next(iter(one.planners.values()))[SIDE.name], SIDE))
    figures = map(html.figure, (*_maps(results), *_spreads(best)))
    parts = [_table(results), *figures, *_worst(results, again)]
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


def _spreads(result: StudyResult) -> Iterator[Drawing]:
    whose = f"Of the design that is on the side longest: {result.design}. " if result.design.swept else ""
    for k, of in enumerate(measures_of(result.settings)):
        known = {name: of.shown(planner[of.name]) for name, planner in result.planners.items()}
        everything = np.concatenate(list(known.values()))
        if everything.size < _SPREAD_RUNS or np.ptp(everything) == 0.0:
            continue  # the table states all there is
        edges = np.histogram_bin_edges(everything, _BINS)
        steps = ((name, np.histogram(values, edges)[0]) for name, values in known.items())
        marks = [
            html.line(np.repeat(edges, 2), np.pad(np.repeat(counts, 2), 1), colour, str(name))
            for (name, counts), colour in zip(steps, itertools.cycle(_COLOURS), strict=False)
        ]
        chart = Chart(Axis(of.label), Axis("runs", (0.0, None)), marks)
        yield Drawing(f"spread-{k}", of.label.capitalize(), f"{whose}How the runs spread.", [chart])


def _maps(results: Sequence[StudyResult]) -> Iterator[Drawing]:
    """Draw the means over the first swept parameter and, where two were swept, over the second one upwards."""
    swept = [dict(one.design.swept) for one in results]
    varied = [key for key in swept[0] if len({values[key] for values in swept}) > 1][:2]
    for k, of in enumerate((SIDE, BAND, MOVES) if varied else ()):
        for planner in results[0].planners:
            yield _map(f"map-{k}-{planner}", planner, of, varied, results)


def _map(name: str, planner: str, of: Measure, keys: Sequence[str], results: Sequence[StudyResult]) -> Drawing:
    swept = [{"": "", **dict(one.design.swept)} for one in results]
    across_key, up_key = (*keys, "")[:2]
    across, up = (list(dict.fromkeys(values[key] for values in swept)) for key in (across_key, up_key))
    found: dict[tuple[int, int], list[float]] = {}
    for values, result in zip(swept, results, strict=True):
        place = up.index(values[up_key]), across.index(values[across_key])
        found.setdefault(place, []).append(_mean(result.planners[planner][of.name], of))
    means = {place: round(float(np.mean(values)), 2) for place, values in found.items()}
    rows = [[means.get((j, i)) for i in range(len(across))] for j in range(len(up))]
    x, y = Axis(across_key, words=[*map(word, across)]), Axis(up_key, words=[*map(word, up)])
    others = " Mean over what else was swept." if len(results) > len(means) else ""
    caption = f"Mean of the runs; empty: cannot be flown.{others}"
    chart = Chart(x, y, [html.mark("cells", "", rows=rows)], height=90 + 30 * len(up))
    return Drawing(name, f"{planner}: {of.label}", caption, [chart])


def _worst(results: Sequence[StudyResult], command: str) -> Iterator[str]:
    """Draw the runs that were on the side shortest of the first planner, and show how to fly each again."""
    found = []
    for result in results:
        planner = next(iter(result.planners.values()))
        sides = zip(planner[SIDE.name].tolist(), planner.runs, strict=True)
        found += [(share, run, result.design) for share, run in sides if math.isfinite(share)]
    found.sort(key=lambda one: one[0])
    for k, (share, run, design) in enumerate(found[:_WORST]):
        track = flown_again(run, design.settings)
        off_m = np.where(track.judged.on_side, np.nan, track.aircraft_m.T)
        marks = [
            html.line(*track.target_m.T, "target", "target", thick=True),
            html.line(*track.aircraft_m.T, "aircraft", "aircraft", t=track.time_s),
            html.line(*off_m, "bad", "off the side", thick=True),
        ]
        swept = "".join(f" --sweep {key}={word(value)}" for key, value in design.swept)
        again = f"{command}{swept} --planner {run.planner} --run {run.number} --report run.html"
        title = f"Run {run.number}: {run.target}, on the side {100.0 * share:.1f} %"
        chart = Chart(Axis("east, m"), Axis("north, m"), marks, equal=True)
        yield html.figure(Drawing(f"worst-{k}", title, "One of the worst runs; fly it again with", [chart]))
        yield f"<p><code>{escape(again)}</code></p>"

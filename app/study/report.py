"""What a study found: tables and a page for people, summaries and rows for programs."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.records.text_file import write_text
from sidelong.app.report import html
from sidelong.app.report.html import Axis, Chart, Drawing
from sidelong.app.study.judging import (
    BAND,
    EXPLAINED,
    MOVES,
    ON_FLAT_GROUND,
    OVER_HILLS,
    SIDE,
    WITHIN_PAN_LIMITS,
    Measure,
    decision_ms,
)
from sidelong.app.study.settings import PARTS, StudySettings, word
from sidelong.app.study.study import MEASURES, PlannerResult, StudyResult, flown_again
from sidelong.mission.core.path import FloatArray

_COLUMNS = ("planner", "run", "target", "draw", "seed", *MEASURES, "key")


def study_title(result: StudyResult) -> str:
    """Return runs, aircraft, targets, wind and sensors in a line of words."""
    s, aircraft = result.settings, result.settings.aircraft()
    sensors = "perfect sensors" if s.perfect_sensors else "noisy laser and gimbal"
    target = f"to {s.requirement().target_speed_max_m_s:g} m/s"
    if s.tracks:
        target = f"recorded, {target}"
        runs = f"{len(s.numbers)} runs, {result.simulated_s / len(s.planners) / 3600.0:.1f} h"
    else:
        runs = f"{len(s.numbers)} runs of {s.duration_s / 60.0:.0f} min"
        target += f", legs of {s.legs_s[0]:g}-{s.legs_s[1]:g} s"
    wind = f"wind {s.config.simulation.wind_speed_m_s:g} m/s"
    if s.config.simulation.turbulence != "none":
        wind += f", {s.config.simulation.turbulence} gusts"
    return (
        f"{runs} at {aircraft.airspeed_m_s:g} m/s on circles of {aircraft.radius_m:g} m; target {target}; "
        f"{wind}; {sensors}"
    )


def study_parts(settings: StudySettings) -> str:
    """Return which parts of the program flew, for headings."""
    return f"closed loop, {settings.autopilot}: {PARTS}"


def measures_of(settings: StudySettings) -> tuple[Measure, ...]:
    """Return the measures that these studies can have, by hills and pan limits."""
    measures = ON_FLAT_GROUND if settings.hills is None else OVER_HILLS
    return (*measures, WITHIN_PAN_LIMITS) if settings.aircraft().has_pan_limit else measures


def right_aligned(table: Table, first: int) -> Table:
    """Return a table with its columns from the ``first`` on aligned to the right, and not broken."""
    for column in table.columns[first:]:
        column.justify, column.no_wrap = "right", True
    return table


def study_table(result: StudyResult) -> Table:
    """Return mean, tail and worst run of each measure, a column for each planner."""
    table = right_aligned(Table("", "", *map(str, result.planners), box=box.SIMPLE_HEAD), 2)
    planners = list(result.planners.values())

    def row(label: str, name: str, digits: int, values: Iterable[float | None]) -> None:
        table.add_row(label, name, *("-" if one is None else f"{one:.{digits}f}" for one in values))

    for of in measures_of(result.settings):
        for name in ("mean", f"p{of.tail}", "worst"):
            label = of.label if name == "mean" else ""
            row(label, name, of.digits, [of.spread(of.shown(one[of.name]))[name] for one in planners])
    row("observation angle, °", "spread", 0, map(_angle_spread_deg, planners))
    for name in ("p50", "p99"):
        label = "decision, ms" if name == "p50" else ""
        row(label, name, 2, [decision_ms(one.decision_s)[name] for one in planners])
    return table


def sweep_rows(results: Sequence[StudyResult]) -> list[tuple[str, ...]]:
    """Return headings, then a row for each design and planner, as text."""
    first, measures = results[0].design, measures_of(results[0].settings)
    keys = (key.partition(".")[2] for key, _ in first.swept)
    rows = [
        (*map(word, dict(one.design.swept).values()), str(name), *(m.cell(planner[m.name]) for m in measures))
        for one in results
        for name, planner in one.planners.items()
    ]
    return [(*keys, "planner", *(one.heading for one in measures)), *rows]


def sweep_table(results: Sequence[StudyResult]) -> Table:
    """Return the sweep's rows as a table for the terminal."""
    headings, *rows = sweep_rows(results)
    table = right_aligned(Table(*headings, box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1)), 0)
    for row in rows:
        table.add_row(*row)
    return table


def targets_json(settings: StudySettings) -> dict[str, Any]:
    """Return the choice of targets for ``--json``."""
    return {
        "runs": settings.runs,
        "noise_draws": settings.noise_draws,
        "seed": settings.seed,
        "parts": PARTS,
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "skipped_targets": [{"file": file, "reason": reason} for file, reason in settings.skipped],
    }


def study_json(results: Sequence[StudyResult]) -> dict[str, Any]:
    """Return the summary that ``--json`` writes; of several designs each with its ``swept`` values."""
    each = [{str(name): _planner_json(one, of.settings) for name, one in of.planners.items()} for of in results]
    summary = {
        "planners": each[0] if len(each) == 1 else {},
        **targets_json(results[0].settings),
        "simulated_s": sum(one.simulated_s for one in results),
        "wall_s": results[0].wall_s,
    }
    if len(each) > 1:
        swept = (dict(one.design.swept) for one in results)
        summary["designs"] = [{"swept": of, "planners": own} for of, own in zip(swept, each, strict=True)]
    return summary


def _planner_json(planner: PlannerResult, settings: StudySettings) -> dict[str, Any]:
    return {
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        **{one.name: one.spread(planner[one.name]) for one in measures_of(settings)},
        "observation_spread_deg": _angle_spread_deg(planner),
        "decision_ms": decision_ms(planner.decision_s),
    }


def _angle_spread_deg(planner: PlannerResult) -> float | None:
    values: FloatArray = planner["observation_spread_deg"]
    return float(np.nanmean(values)) if np.isfinite(values).any() else None


def export_runs(results: Sequence[StudyResult], file: Path) -> None:
    """Write a row for each run, as CSV. Columns: swept parameters, then the same for every study. Raises OSError."""
    columns = (*(key for key, _ in results[0].design.swept), *_COLUMNS)
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([columns, *_rows(results)])


def _rows(results: Sequence[StudyResult]) -> Iterator[tuple[Any, ...]]:
    for one in results:
        swept = [value for _, value in one.design.swept]
        for name, planner in one.planners.items():
            for k, run in enumerate(planner.runs):
                values = (float(planner[measure][k]) for measure in MEASURES)
                whose = str(name), run.number, run.target, run.draw, one.settings.seed
                yield *swept, *whose, *(None if math.isnan(value) else value for value in values), run.key


_BINS, _WORST = 40, 4
_SPREAD_RUNS = 10  # of fewer runs a histogram shows nothing
_TABLED = 200  # rows
_COLOURS = ("aircraft", "target", "estimate", "third", "fourth", "bad", "circle", "faint")  # of planners


def write_page(results: Sequence[StudyResult], command: str, again: str, file: Path) -> None:
    """Write the page, with the command as given, and as ``again`` flies one run again. Raises OSError."""
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
            html.line((np.repeat(edges, 2), np.pad(np.repeat(counts, 2), 1)), colour, str(name))
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
            html.line(track.target_m.T, "target", "target", thick=True),
            html.line(track.aircraft_m.T, "aircraft", "aircraft", t=track.time_s),
            html.line(off_m, "bad", "off the side", thick=True),
        ]
        swept = "".join(f" --sweep {key}={word(value)}" for key, value in design.swept)
        again = f"{command}{swept} --planner {run.planner} --run {run.number} --report run.html"
        title = f"Run {run.number}: {run.target}, on the side {100.0 * share:.1f} %"
        chart = Chart(Axis("east, m"), Axis("north, m"), marks, equal=True)
        yield html.figure(Drawing(f"worst-{k}", title, "One of the worst runs; fly it again with", [chart]))
        yield f"<p><code>{escape(again)}</code></p>"

"""A study on one page: figures of each design, how the runs spread, maps over what was swept, the worst runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from sidelong.app.report import html
from sidelong.app.report.plot_style import BAD, figure, legend_above, styled
from sidelong.app.study.design import Design
from sidelong.app.study.judging import Track
from sidelong.app.study.report import HEADINGS_EXPLAINED, study_fidelity, study_title, summary_headings, summary_row
from sidelong.app.study.settings import PlannerName
from sidelong.app.study.store import RunId
from sidelong.app.study.study import PlannerResult, Study, StudyResult, flown_again

FloatArray = npt.NDArray[np.float64]

_BINS = 40
_WORST = 4
_TABLED = 200  # designs

# What is drawn: title, values, how a design's runs are summed up on maps.
_DRAWN: tuple[tuple[str, Callable[[PlannerResult], FloatArray]], ...] = (
    ("time on side, %", lambda p: 100.0 * p.time_on_side),
    ("time on side by the present course, %", lambda p: 100.0 * p.time_on_side_now),
    ("time in band, %", lambda p: 100.0 * p.time_in_band),
    ("least range, m", lambda p: p.min_range_m),
    ("moves per hour", lambda p: p.moves_per_hour),
    ("reversals (moves within 10 s of the last one) per hour", lambda p: p.reversals_per_hour),
    ("time in sight, %", lambda p: 100.0 * p.time_in_sight),
    ("least height over ground, m", lambda p: p.min_clearance_m),
)
_MAPPED = _DRAWN[0], _DRAWN[2], _DRAWN[4]


def write_page(study: Study, command: str, file: Path) -> None:
    """Write the page. command: what flies this study, without what was swept. Raises OSError."""
    keys = [key for key, _ in study.designs[0].swept]
    with styled():
        parts = [_tables(study, keys)]
        if len(study.designs) > 1:
            parts += map(html.figure, _maps(study, keys))
        best = _best(study)
        parts += map(html.figure, _spreads(study.result(best), best))
        parts += _worst(study, command)
    title = (
        study_title(study.result(study.designs[0])) if len(study.designs) == 1 else f"{len(study.designs)} designs"
    )
    parts_flown = study_fidelity(study.designs[0].settings)
    head = f"<h1>Study</h1><p>{escape(title)}; {escape(parts_flown)}.</p><p><code>{escape(command)}</code></p>"
    file.write_text(html.document("sidelong study", head + "\n".join(parts)), encoding="utf-8")


def _tables(study: Study, keys: list[str]) -> str:
    rows = [
        (*(_word(value) for _, value in design.swept), str(name), *summary_row(design.settings, planner))
        for design in study.designs[:_TABLED]
        for name, planner in study.result(design).planners.items()
    ]
    more = len(study.designs) - _TABLED
    left_out = f"<p>{more} more designs are not shown; --export writes all.</p>" if more > 0 else ""
    headings = (*keys, "planner", *summary_headings(study.designs[0].settings))
    return f"{html.table(headings, rows, 'Designs')}<p>{HEADINGS_EXPLAINED}</p>{left_out}"


def _word(value: float | str) -> str:
    return f"{value:g}" if isinstance(value, float) else value


def _best(study: Study) -> Design:
    """Return the design whose first planner is on the side longest."""
    return max(study.designs, key=lambda one: _mean(next(iter(study.result(one).planners.values())).time_on_side))


def _mean(values: FloatArray) -> float:
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else 0.0


def _spreads(result: StudyResult, design: Design) -> Iterator[html.Drawing]:
    whose = f"Of the design that is on the side longest: {design}. " if design.swept else ""
    for k, (title, values) in enumerate(_DRAWN):
        drawn, (axes,) = figure(2.4)
        known = {name: values(planner) for name, planner in result.planners.items()}
        known = {name: v[np.isfinite(v)] for name, v in known.items()}
        if not any(v.size for v in known.values()):
            continue
        everything = np.concatenate(list(known.values()))
        least, most = everything.min(), everything.max()
        edges = np.linspace(least, most, _BINS + 1) if most > least else np.array([least, least + 1.0])
        for name, v in known.items():
            axes.stairs(np.histogram(v, edges)[0], edges, label=str(name))
        axes.set(xlabel=title, ylabel="runs")
        legend_above(axes)
        yield html.Drawing(f"spread-{k}", title.capitalize(), f"{whose}How the runs spread.", drawn)


def _maps(study: Study, keys: list[str]) -> Iterator[html.Drawing]:
    """Draw the means over one swept parameter, or over each of its values and those of the next."""
    planners = study.designs[0].settings.planners
    results = [(dict(design.swept), study.result(design)) for design in study.designs]
    varied = [key for key in keys if len({swept[key] for swept, _ in results}) > 1][:2]
    if not varied:
        return
    for k, (title, values) in enumerate(_MAPPED):
        if len(varied) == 1:
            drawn, (axes,) = figure(2.8)
            for planner in planners:
                at = {str(_word(s[varied[0]])): _mean(values(r.planners[planner])) for s, r in results}
                axes.plot(list(at), list(at.values()), "o-", label=str(planner))
            axes.set(xlabel=varied[0], ylabel=f"{title}, mean")
            legend_above(axes)
            yield html.Drawing(f"swept-{k}", title.capitalize(), f"Over {varied[0]}.", drawn)
            continue
        for planner in planners:
            yield _map(f"map-{k}-{planner}", planner, title, varied, results, values)


def _map(
    name: str,
    planner: PlannerName,
    title: str,
    keys: list[str],
    results: list[tuple[dict[str, float | str], StudyResult]],
    values: Callable[[PlannerResult], FloatArray],
) -> html.Drawing:
    across, up = (list(dict.fromkeys(swept[key] for swept, _ in results)) for key in keys)
    sums, counts = np.zeros((len(up), len(across))), np.zeros((len(up), len(across)))
    for swept, result in results:
        place = up.index(swept[keys[1]]), across.index(swept[keys[0]])
        sums[place] += _mean(values(result.planners[planner]))
        counts[place] += 1
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    drawn, (axes,) = figure(1.6 + 0.3 * len(up))
    axes.grid(visible=False)
    image = axes.imshow(means, origin="lower", aspect="auto", cmap="viridis")
    axes.set(xlabel=keys[0], ylabel=keys[1])
    axes.set_xticks(range(len(across)), [_word(value) for value in across])
    axes.set_yticks(range(len(up)), [_word(value) for value in up])
    if means.size <= 120:
        middle = np.nanmean([np.nanmin(means), np.nanmax(means)])
        for (row, column), value in np.ndenumerate(means):
            if np.isfinite(value):
                colour = "black" if value > middle else "white"
                axes.text(column, row, f"{value:.1f}", ha="center", va="center", color=colour, fontsize=8)
    drawn.colorbar(image, ax=axes, label=title)
    others = " Mean over what else was swept." if counts.max(initial=1.0) > 1 else ""
    return html.Drawing(name, f"{planner}: {title}", f"Mean of the runs; empty: cannot be flown.{others}", drawn)


def _draw_path(axes: Axes, track: Track) -> None:
    axes.plot(*track.aircraft_m.T, linewidth=0.8, label="aircraft")
    axes.plot(*track.target_m.T, "k", linewidth=2.0, label="target")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal", adjustable="datalim")


def _worst(study: Study, command: str) -> Iterator[str]:
    """Draw the runs that were on the side shortest of the first planner, and show how to fly each again."""
    found: list[tuple[float, RunId, Design]] = []
    for design in study.designs:
        planner = next(iter(study.result(design).planners.values()))
        sides = planner.time_on_side
        order = np.argsort(np.where(np.isfinite(sides), sides, np.inf))[:_WORST]
        found += [(float(sides[k]), planner.runs[k], design) for k in order if np.isfinite(sides[k])]
    found.sort(key=lambda one: one[0])
    for k, (share, run, design) in enumerate(found[:_WORST]):
        drawn, (axes,) = figure(4.2)
        track = flown_again(run, design.settings)
        _draw_path(axes, track)
        axes.plot(*track.aircraft_m[~track.judged.on_side].T, ".", color=BAD, markersize=2.0, label="off the side")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        swept = "".join(f" --sweep {key}={_word(value)}" for key, value in design.swept)
        again = f"{command}{swept} --planner {run.planner} --run {run.number} --report run.html"
        title = f"Run {run.number}: {run.target}, on the side {100.0 * share:.1f} %"
        yield html.figure(html.Drawing(f"worst-{k}", title, "One of the worst runs; fly it again with", drawn))
        yield f"<p><code>{escape(again)}</code></p>"

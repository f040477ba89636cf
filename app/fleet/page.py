"""The report of a fleet's flight: the results of all together, with links to the page of each aircraft."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from sidelong.app.analysis.score import Asked
from sidelong.app.fleet.flown import FleetFlown
from sidelong.app.report import html
from sidelong.mission.viewpoint.side_policy import side_words


def fleet_page(flown: FleetFlown, pages: Mapping[str, str]) -> str:
    """Return the page. pages: where each aircraft's own is, as seen from it."""
    begin_s = max(one.flown.history.start_s + one.offset_s for one in flown.aircraft)  # all are watching
    words = {name: _asked_words(asked, begin_s) for name, asked in flown.asked.items()}
    wanted = "; ".join(f"{name} {own}" for name, own in words.items())
    links = ", ".join(f'<a href="{escape(page)}">{escape(name)}</a>' for name, page in pages.items())
    body = f"""<h1>Flight {escape(flown.name)}, {len(flown.aircraft)} aircraft</h1>
<p>Asked: watch {escape(wanted)}.
Recorded by {escape(flown.program)}. Each aircraft: {links}.</p>
{_figures(flown)}
{_announced(flown)}"""
    return html.document(f"{flown.name}: flight report", body)


def _asked_words(asked: Asked, begin_s: float) -> str:
    words = [f"from the {side_words(one)} at {one.range_min_m:g} to {one.range_max_m:g} m" for _, one in asked]
    later = zip((at_s - begin_s for at_s, _ in asked[1:]), words[1:], strict=True)
    return words[0] + "".join(f", after {at_s:.0f} s {changed}" for at_s, changed in later)


def _figures(flown: FleetFlown) -> str:
    table = flown.summary.table()
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    height = max(map(len, columns))
    rows = zip(*(column + [""] * (height - len(column)) for column in columns), strict=True)
    return html.table((str(column.header) for column in table.columns), rows, "Summary")


def _announced(flown: FleetFlown) -> str:
    if not flown.announced:
        return ""
    start_s = min(one.flown.history.start_s + one.offset_s for one in flown.aircraft)
    rows = ((f"{one.mission_time_s - start_s:.0f} s", one.name, one.text) for one in flown.announced)
    table = html.table(("time", "aircraft", "what"), rows, "Announcements of the coordinator")
    return f"<details><summary>Announcements of the coordinator ({len(flown.announced)})</summary>{table}</details>"

"""One HTML file that needs nothing else: figures as inlined SVG, tables, no script, no remote address."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path

from sidelong.app.report import html
from sidelong.app.report.figures import drawings
from sidelong.app.report.plot_style import styled
from sidelong.app.report.sources import FlightRecord
from sidelong.mission.viewpoint.side_policy import side_words

_PNG_DPI = 150


def report_page(flown: FlightRecord) -> str:
    """Return the page."""
    with styled():
        figures = "\n".join(html.figure(drawing) for drawing in drawings(flown.history))
    damaged = f"; {flown.damaged_lines} damaged lines were passed over" if flown.damaged_lines else ""
    body = f"""<h1>Flight {escape(flown.name)}</h1>
<p>{escape(_asked(flown))}. Recorded by {escape(flown.program)}{damaged}.</p>
{html.tiles(flown.summary.rows())}
{figures}
{_decisions(flown)}
{_configuration(flown)}"""
    return html.document(f"{flown.name}: flight report", body)


def save_png(flown: FlightRecord, folder: Path) -> list[Path]:
    """Write each figure into ``folder`` (made if missing) and return the files. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with styled():
        for drawing in drawings(flown.history):
            files.append(folder / f"{drawing.name}.png")
            drawing.figure.savefig(files[-1], dpi=_PNG_DPI)
    return files


def _asked(flown: FlightRecord) -> str:
    requirement, airframe = flown.history.requirement, flown.history.asked.airframe
    return (
        f"Asked: watch from the {side_words(requirement)} "
        f"at {requirement.range_min_m:g} to {requirement.range_max_m:g} m, "
        f"circles of {airframe.radius_m:g} m at {airframe.airspeed_m_s:g} m/s"
        + "".join(
            f"; from {since_s - flown.history.start_s:.0f} s on from the {side_words(one)} "
            f"at {one.range_min_m:g} to {one.range_max_m:g} m"
            for since_s, one in flown.history.requirements[1:]
        )
    )


def _decisions(flown: FlightRecord) -> str:
    announced, start_s = flown.history.announced, flown.history.start_s
    rows = [(f"{one.time_s - start_s:.0f} s", one.kind, one.text) for one in announced]
    return _details(f"Decisions and announcements ({len(rows)})", rows) if rows else ""


def _configuration(flown: FlightRecord) -> str:
    sections = flown.config.model_dump(mode="json").items()
    rows = [
        (f"{section}.{key}", str(value))
        for section, keys in sections
        for key, value in keys.items()
        if value not in (None, [])
    ]
    return _details("Configuration", rows)


def _details(summary: str, rows: Iterable[tuple[str, ...]]) -> str:
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<details><summary>{summary}</summary><table>{lines}</table></details>"

"""The report of a flight: one page that needs nothing else."""

from __future__ import annotations

import math
from contextlib import suppress
from datetime import datetime
from html import escape

import numpy as np

from sidelong.app.analysis.summary import Summary, percent
from sidelong.app.report import html
from sidelong.app.report.figures import drawings
from sidelong.app.report.history import clock
from sidelong.app.report.sources import FlightRecord
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.viewpoint.side_policy import side_words

_STAMP = len("20261121T103058Z")
_FOR_CLIENTS = "path", "range", "observation-angle"
_TILES = "attention", "outcome", "watched", "time in band", "time on side", "range", "moves of the circle"


def report_page(flown: FlightRecord) -> str:
    """Return the page."""
    figures = {drawing.name: html.figure(drawing) for drawing in drawings(flown.history)}
    client = "\n".join(figures.pop(name) for name in _FOR_CLIENTS if name in figures)
    damaged = f"; {flown.damaged_lines} damaged lines were passed over" if flown.damaged_lines else ""
    rows = list(flown.summary.rows())
    first = [row for row in rows if row[0] in _TILES]
    others = [row for row in rows if row[0] not in _TILES]
    engineers = "\n".join((html.tiles(others), *figures.values(), _configuration(flown)))
    body = f"""<h1>Flight {escape(flown.name)}</h1>
<p class="verdict">{escape(verdict(flown.summary, flown.history.requirement))}</p>
<p>{escape(_where(flown))}. {escape(_asked(flown))}. Recorded by {escape(flown.program)}{damaged}.</p>
{html.tiles(first)}
{client}
{_decisions(flown)}
<details class="engineers"><summary>For engineers</summary>
{engineers}
</details>"""
    return html.document(f"{flown.name}: flight report", body)


def verdict(summary: Summary, requirement: Requirement) -> str:
    """Return in one sentence how well the target was watched."""
    side, band = summary.time_on_side, summary.time_in_band
    if side is None and band is None:
        return "It is not known how well the target was watched."
    limits = f"{requirement.range_min_m:g} to {requirement.range_max_m:g} m"
    shares = (side, f"from the {side_words(requirement)}"), (band, f"within {limits}")
    known = " and ".join(f"{percent(share)} of the time {where}" for share, where in shares if share is not None)
    by = "" if summary.source == "truth" else ", by its own estimate"
    return f"The target was watched for {clock(summary.duration_s)} min: {known}{by}."


def _where(flown: FlightRecord) -> str:
    """Return date, place, target and home of the flight, as far as they are known."""
    history, parts = flown.history, []
    with suppress(ValueError):
        begun = datetime.strptime(flown.name[:_STAMP], "%Y%m%dT%H%M%SZ")  # it is UTC by its name
        parts.append(f"{begun:%A, %d %B %Y, %H:%M} UTC".replace(", 0", ", "))
    parts.append(f"at {history.plane.origin_latitude_deg:.4f}, {history.plane.origin_longitude_deg:.4f}")
    speeds_m_s = [one.speed_m_s for one in history.estimates]
    if speeds_m_s:
        parts.append(f"a target of up to {float(np.quantile(speeds_m_s, 0.95)):.1f} m/s")
    if history.wind is not None:
        parts.append(f"wind {math.hypot(history.wind.east_m_s, history.wind.north_m_s):.0f} m/s")
    return "; ".join(parts)


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
    numbers = {id(one): str(number) for number, one in enumerate(flown.history.moves, 1)}
    rows = [(clock(one.time_s - start_s), numbers.get(id(one), ""), one.kind, one.text) for one in announced]
    words = f"Decisions and announcements ({len(rows)})"
    return html.folded(words, html.table((), rows, words), is_open=True) if rows else ""


def _configuration(flown: FlightRecord) -> str:
    sections = flown.config.model_dump(mode="json").items()
    rows = [
        (f"{section}.{key}", str(value))
        for section, keys in sections
        for key, value in keys.items()
        if value not in (None, [])
    ]
    return html.folded("Configuration", html.table((), rows, "Configuration"))

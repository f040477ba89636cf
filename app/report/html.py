"""Pages that need nothing else: charts as data, drawn by the live page's ``charts.js``, and tables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_POINTS_MAX = 6000  # of one line
_LONG, _TILE_CHARACTERS = ' class="long"', 24
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"

Mark = dict[str, Any]  # lines, bands and the like; the head of ``charts.js`` describes each kind


@dataclass(frozen=True, slots=True)
class Axis:
    """What ``charts.js`` has of an axis. A None in the range: as far as the marks reach."""

    label: str
    range: tuple[float | None, float | None] = (None, None)
    time: bool = False
    degrees: bool = False
    words: Sequence[str] | None = None


@dataclass(frozen=True, slots=True)
class Chart:
    """One pair of axes. equal: a metre is as long across as up; height: px, otherwise."""

    x: Axis
    y: Axis
    marks: Sequence[Mark]
    equal: bool = False
    height: int = 240


@dataclass(frozen=True, slots=True)
class Drawing:
    """Charts with a name, a title, and what they show, in a sentence or two."""

    name: str
    title: str
    caption: str
    charts: Sequence[Chart]


def mark(kind: str, of: str, label: str = "", **values: Any) -> Mark:
    """Return a mark. Arrays are rounded to what can be seen, thinned where they are long, and have no NaN."""
    plain = {key: _plain(value) if isinstance(value, np.ndarray) else value for key, value in values.items()}
    return {"kind": kind, "of": of, "label": label, **plain}


def line(points: Iterable[ArrayLike], of: str, label: str = "", **more: Any) -> Mark:
    """Return a line; points: x and y, each of shape (n,)."""
    x, y = map(np.asarray, points)
    return mark("line", of, label, x=x, y=y, **more)


def _plain(values: np.ndarray) -> list[Any]:
    values = np.asarray(values, float)[:: max(1, -(-len(values) // _POINTS_MAX))]
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if known.size else 0.0
    digits = 5 - math.ceil(math.log10(span)) if span > 0.0 else 3
    return [None if math.isnan(value) else value for value in np.round(values, digits).tolist()]


def document(title: str, body: str) -> str:
    """Return a page that needs no other file; ``body`` is HTML, the title plain text."""
    style = (files("sidelong.app.report") / "report.css").read_text(encoding="utf-8")
    charts = (files("sidelong.app.view") / "page" / "charts.js").read_text(encoding="utf-8")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<meta name="viewport" content="width=device-width">
<title>{escape(title)}</title>
<style>{style}</style>
</head>
<body>
{body}
<noscript><p>The charts need JavaScript.</p></noscript>
<script type="module">
{charts}
for (const figure of document.querySelectorAll("figure"))
  for (const chart of JSON.parse(figure.querySelector("script").textContent))
    new Chart(chart, figure.querySelector("h2").textContent, figure);
</script>
</body>
</html>
"""


def tiles(results: Iterable[tuple[str, str]]) -> str:
    """Return (name, value) pairs of plain text as a list in HTML."""
    tiles = "".join(
        f"<div{_LONG if len(value) > _TILE_CHARACTERS else ''}><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
        for name, value in results
    )
    return f"<dl>{tiles}</dl>"


def table(headings: Iterable[str], rows: Iterable[Iterable[str]], about: str) -> str:
    """Return a table of plain words, scrolled also by keys if it is too wide; keys break at their dots."""
    head = "".join(f"<th>{escape(heading).replace('.', '.<wbr>')}</th>" for heading in headings)
    head = f"<tr>{head}</tr>" if head else ""
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    scrolled = f'class="wide" tabindex="0" role="group" aria-label="{escape(about)}"'
    return f"<div {scrolled}><table>{head}{body}</table></div>"


def folded(summary: str, content: str, *, is_open: bool = False) -> str:
    """Return HTML content that a click on the summary, plain text, unfolds."""
    return f"<details{' open' if is_open else ''}><summary>{escape(summary)}</summary>{content}</details>"


def figure(drawing: Drawing) -> str:
    """Return the figure with its heading; ``document`` draws its charts."""
    data = json.dumps([asdict(chart) for chart in drawing.charts], separators=(",", ":"), allow_nan=False)
    data = data.replace("<", r"\u003c")  # no word of it ends the script
    return (
        f'<figure id="{drawing.name}"><h2>{escape(drawing.title)}</h2><p>{escape(drawing.caption)}</p>'
        f'<script type="application/json">{data}</script></figure>'
    )

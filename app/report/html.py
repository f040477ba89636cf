"""Pages that need nothing else: figures as inlined SVG, no script, no remote address."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape

from matplotlib.figure import Figure

_CSS = """
:root { color-scheme: light dark; --ink: #222; --soft: #555; --paper: #fff; --line: #eee; --mark: #1f5f9e; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaef; --soft: #a9b4c0; --paper: #12161b; --line: #2b333c; --mark: #78b4f0; }
  figure svg { filter: invert(1) hue-rotate(180deg); }
}
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0; }
h2 { font-size: 1.1rem; margin: 2.2rem 0 .2rem; }
p { margin: .2rem 0 .6rem; color: var(--soft); }
svg { width: 100%; height: auto; }
.verdict { font-size: 1.2rem; color: var(--ink); }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(11rem, 1fr)); gap: .6rem; margin: 1.2rem 0; }
dl div { border-top: 2px solid var(--mark); padding: .3rem 0; }
dl .long { grid-column: span 2; }
.long dd { font-size: 1rem; }
dt { color: var(--soft); font-size: .85rem; }
dd { margin: 0; font-size: 1.15rem; font-variant-numeric: tabular-nums; }
table { border-collapse: collapse; font-size: .9rem; }
td, th { text-align: left; padding: .15rem .9rem .15rem 0; vertical-align: top;
  border-bottom: 1px solid var(--line); }
td:first-child { font-variant-numeric: tabular-nums; white-space: nowrap; }
[aria-label="Designs"] td { white-space: nowrap; }
summary { cursor: pointer; font-weight: 600; margin-top: 1.5rem; }
figure { margin: 0; break-inside: avoid; }
.wide { overflow-x: auto; }
code { overflow-wrap: anywhere; }
@media print {
  @page { size: A4; margin: 14mm; }
  body { margin: 0; max-width: none; } details:not([open]) { display: none; }
}
@media (max-width: 700px) {
  body { margin: 1rem auto; } dl { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  td { overflow-wrap: break-word; } td:first-child { white-space: normal; min-width: 4.5rem; }
}
"""
_LONG, _TILE_CHARACTERS = ' class="long"', 24


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A figure with its name (a file's name too) and what it shows, in a sentence or two."""

    name: str
    title: str
    caption: str
    figure: Figure


def document(title: str, body: str) -> str:
    """Return the page."""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{escape(title)}</title>
<style>{_CSS}</style>
</head>
<body>
{body}
</body>
</html>
"""


def tiles(results: Iterable[tuple[str, str]]) -> str:
    """Return names and values side by side."""
    tiles = "".join(
        f"<div{_LONG if len(value) > _TILE_CHARACTERS else ''}><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
        for name, value in results
    )
    return f"<dl>{tiles}</dl>"


def table(headings: Iterable[str], rows: Iterable[Iterable[str]], about: str) -> str:
    """Return a table of plain words, that scrolls if it is too wide; ``about`` states its content.

    Headings that are keys of a configuration may break at their dots.
    """
    head = "".join(f"<th>{escape(heading).replace('.', '.<wbr>')}</th>" for heading in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return _wide(f"<table><tr>{head}</tr>{body}</table>", about)


def _wide(content: str, about: str) -> str:
    """Return what may be wider than a telephone: it is scrolled, also by keys, and the page is not."""
    return f'<div class="wide" tabindex="0" role="group" aria-label="{escape(about)}">{content}</div>'


def figure(drawing: Drawing) -> str:
    """Return the figure with its heading. Use within ``plot_style.styled()``."""
    return (
        f'<figure id="{drawing.name}"><h2>{escape(drawing.title)}</h2><p>{escape(drawing.caption)}</p>'
        f"{_wide(_svg(drawing), drawing.title)}</figure>"
    )


def _svg(drawing: Drawing) -> str:
    """Return the figure as an element of HTML: without prolog, metadata, name spaces, or ids of its neighbours."""
    buffer = io.StringIO()
    drawing.figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    text = text.replace("xlink:href", "href")
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', text))
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{drawing.name}-{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="|url\()#', rf"\1#{drawing.name}-", text)
    label = f'<svg role="img" aria-label="{escape(drawing.title)}"'
    return text.replace("<svg", label, 1).rstrip()

"""One HTML file that needs nothing else: figures as inlined SVG, tables, no script, no remote address."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from html import escape
from pathlib import Path

from app.report.figures import Drawing, drawings
from app.report.plot_style import styled
from app.report.results import rows
from app.report.sources import Flown
from mission.core.events import Announce

_PNG_DPI = 150
_CSS = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0; }
h2 { font-size: 1.1rem; margin: 2.2rem 0 .2rem; }
p { margin: .2rem 0 .6rem; color: #555; }
svg { width: 100%; height: auto; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(11rem, 1fr)); gap: .6rem; margin: 1.2rem 0; }
dl div { border-top: 2px solid #1f5f9e; padding: .3rem 0; }
dt { color: #555; font-size: .85rem; }
dd { margin: 0; font-size: 1.15rem; font-variant-numeric: tabular-nums; }
table { border-collapse: collapse; font-size: .9rem; }
td, th { text-align: left; padding: .15rem .9rem .15rem 0; vertical-align: top; border-bottom: 1px solid #eee; }
td:first-child { font-variant-numeric: tabular-nums; white-space: nowrap; }
summary { cursor: pointer; font-weight: 600; margin-top: 1.5rem; }
figure { margin: 0; break-inside: avoid; }
"""


def report_page(flown: Flown) -> str:
    """Return the page."""
    with styled():
        figures = "\n".join(_figure(drawing) for drawing in drawings(flown.history))
    damaged = f"; {flown.damaged_lines} damaged lines were passed over" if flown.damaged_lines else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{escape(flown.name)}: flight report</title>
<style>{_CSS}</style>
</head>
<body>
<h1>Flight {escape(flown.name)}</h1>
<p>{escape(_asked(flown))}. Recorded by {escape(flown.program)}{damaged}.</p>
{_tiles(rows(flown.summary))}
{figures}
{_decisions(flown)}
{_configuration(flown)}
</body>
</html>
"""


def save_png(flown: Flown, folder: Path) -> list[Path]:
    """Write each figure into ``folder`` (made if missing) and return the files. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with styled():
        for drawing in drawings(flown.history):
            files.append(folder / f"{drawing.name}.png")
            drawing.figure.savefig(files[-1], dpi=_PNG_DPI)
    return files


def _asked(flown: Flown) -> str:
    requirement, airframe = flown.history.requirement, flown.history.asked.airframe
    return (
        f"Asked: watch from the {requirement.side} at {requirement.range_min_m:g} to {requirement.range_max_m:g} m, "
        f"circles of {airframe.radius_m:g} m at {airframe.airspeed_m_s:g} m/s"
    )


def _tiles(results: Iterable[tuple[str, str]]) -> str:
    tiles = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in results)
    return f"<dl>{tiles}</dl>"


def _figure(drawing: Drawing) -> str:
    return (
        f'<figure id="{drawing.name}"><h2>{escape(drawing.title)}</h2><p>{escape(drawing.caption)}</p>'
        f"{_svg(drawing)}</figure>"
    )


def _svg(drawing: Drawing) -> str:
    """Return the figure as an element of HTML: without prolog, metadata, name spaces, or ids of its neighbours."""
    buffer = io.StringIO()
    drawing.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
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


def _decisions(flown: Flown) -> str:
    said = flown.history.said
    if not said:
        return ""
    rows = "".join(
        f"<tr><td>{_clock(one, flown.history.start_s)}</td><td>{one.kind}</td><td>{escape(one.text)}</td></tr>"
        for one in said
    )
    return f"<details><summary>What was decided and said ({len(said)})</summary><table>{rows}</table></details>"


def _clock(said: Announce, start_s: float) -> str:
    return f"{said.time_s - start_s:.0f} s"


def _configuration(flown: Flown) -> str:
    rows = "".join(
        f"<tr><td>{section}.{key}</td><td>{escape(str(value))}</td></tr>"
        for section, keys in flown.config.model_dump(mode="json").items()
        for key, value in keys.items()
        if value not in (None, [])
    )
    return f"<details><summary>Configuration</summary><table>{rows}</table></details>"

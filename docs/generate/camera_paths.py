"""Draw how a camera's tracker followed recorded targets from several paths: ``python docs/generate/camera_paths.py``.

Reads docs/images/camera_paths.csv, which ``tests/bench/test_camera_paths.py`` writes, and writes the SVG next to it.
"""

import csv
import math
from collections import defaultdict
from pathlib import Path
from statistics import fmean

IMAGES = Path(__file__).parents[1] / "images"
PANELS = {  # columns of the file, and how they are called
    "lost %": ("lost", "% of the time"),
    "losses per hour": ("losses", "per hour"),
    "angle of view deg/s": ("change of angle of view", "degrees/s"),
    "scale %/s": ("change of scale", "%/s"),
    "on side %": ("on the required side", "% of the time"),
}
LEFT, TOP, PANEL, GAP, ROW = 130, 60, 130, 24, 34
STYLE = """svg { color: #24292f; font: 12px sans-serif } .dot { color: #0b5cad } .mean { color: #b3400a }
@media (prefers-color-scheme: dark) { svg { color: #e6edf3 } .dot { color: #6cb6ff } .mean { color: #ff9d5c } }
text { fill: currentColor } line { stroke: currentColor } circle { fill: currentColor; opacity: .55 }
.faint { opacity: .3 } .mean line { stroke-width: 3 } .middle { text-anchor: middle } .end { text-anchor: end }"""


def main() -> None:
    """Write the picture."""
    values = defaultdict(list)
    with (IMAGES / "camera_paths.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            values[row["path"]].append(row)
    height = TOP + ROW * len(values) + 8
    width = LEFT + len(PANELS) * (PANEL + GAP)
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">']
    lines += ["<title>A camera's tracker on five kinds of paths: each target, and their mean</title>"]
    lines += [f"<style>\n{STYLE}\n</style>"]
    for number, path in enumerate(values):
        lines.append(f'<text x="0" y="{TOP + ROW * (number + 0.5) + 4:.0f}">{path}</text>')
    for panel, (column, title) in enumerate(PANELS.items()):
        left = LEFT + panel * (PANEL + GAP)
        by_path = [[float(row[column]) for row in rows] for rows in values.values()]
        most = max(value for one in by_path for value in one if math.isfinite(value))
        step = 0.5 * 10.0 ** math.floor(math.log10(most))
        most = 100.0 if "side" in column else step * math.ceil(most / step)
        for number, text in enumerate(title):
            lines.append(f'<text class="middle" x="{left + PANEL / 2:.0f}" y="{12 + 15 * number}">{text}</text>')
        for share in (0.0, 1.0):
            x = left + share * PANEL
            lines.append(f'<text class="middle" x="{x:.0f}" y="{TOP - 12}">{share * most:g}</text>')
            lines.append(f'<line class="faint" x1="{x:.0f}" y1="{TOP - 6}" x2="{x:.0f}" y2="{height - 8}"/>')
        for number, flown in enumerate(by_path):
            known, y = [value for value in flown if math.isfinite(value)], TOP + ROW * (number + 0.5)
            dots = (f'<circle cx="{left + PANEL * value / most:.1f}" cy="{y:.0f}" r="3"/>' for value in known)
            lines.append('<g class="dot">' + "".join(dots) + "</g>")
            x = left + PANEL * fmean(known) / most
            lines.append(f'<g class="mean"><line x1="{x:.1f}" y1="{y - 10:.0f}" x2="{x:.1f}" y2="{y + 10:.0f}"/></g>')
    (IMAGES / "camera_paths.svg").write_text("\n".join([*lines, "</svg>"]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""A flight as an animated SVG: aircraft, target, line of sight and circles, on light and dark backgrounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.records.track import FlownTrack

_SPEED = 20.0  # flight time over playing time
_LONGEST_S = 600.0  # the last part of a longer flight is shown
_STEP_S = 1.0
_WIDTH, _MARGIN = 720.0, 40.0
Placed = Callable[[np.ndarray], np.ndarray]
_STYLE = """
svg { color: #24292f; background: #fff; font: 13px sans-serif }
.aircraft { color: #0b5cad } .target { color: #b3400a } .now { color: #6d3fc0 }
@media (prefers-color-scheme: dark) {
  svg { color: #e6edf3; background: #0d1117 }
  .aircraft { color: #6cb6ff } .target { color: #ff9d5c } .now { color: #c5a3ff }
}
path, line, circle { fill: none; stroke: currentColor; stroke-linejoin: round }
.solid { fill: currentColor } .faint { opacity: .25 } text { fill: currentColor; stroke: none }
"""


def animated_svg(flights: Sequence[FlownTrack]) -> str:
    """Return the picture of the last ten minutes, at 20 times real time. Raises InputError without a target."""
    if not any(flight.estimates for flight in flights):
        raise InputError(f"{flights[0].name} has no target, so there is no animation to export; try --format kml.")
    end_s = min(flight.aircraft[-1].time_s for flight in flights)
    begin_s = max(flight.estimates[0].time_s for flight in flights if flight.estimates)
    times_s = np.arange(max(begin_s, end_s - _LONGEST_S), end_s, _STEP_S)
    tracks = [_at(times_s, flight.aircraft) for flight in flights]
    targets = [_at(times_s, flight.estimates) for flight in flights if flight.estimates]
    everything = np.concatenate([*tracks, *targets])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = (_WIDTH - 2.0 * _MARGIN) / max(high[0] - low[0], 1.0)
    height = (high[1] - low[1]) * scale + 2.0 * _MARGIN

    def placed(points: np.ndarray) -> np.ndarray:
        return np.column_stack(
            (_MARGIN + (points[:, 0] - low[0]) * scale, height - _MARGIN - (points[:, 1] - low[1]) * scale)
        )

    seconds = len(times_s) * _STEP_S / _SPEED
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img">',
        "<title>An aircraft circles on one side of a moving target and relocates its circle</title>",
        f"<style>{_STYLE}</style>",
        *_legend(scale, height),
    ]
    for target in targets:
        lines += _moving(placed(target), "target", seconds, 'circle r="5" class="solid"')
    for flight, track in zip(flights, tracks, strict=True):
        lines += _circles(flight, times_s, seconds, placed, scale)
        lines += _sight(placed(track), placed(targets[0]), seconds)
        lines += _moving(placed(track), "aircraft", seconds, 'path d="M9 0L-7 6L-3 0L-7 -6Z" class="solid"')
    return "\n".join([*lines, "</svg>"]) + "\n"


def _at(times_s: np.ndarray, moments: Sequence[object]) -> np.ndarray:
    """Return (east, north) at each time, m: (n, 2)."""
    known = np.array([(one.time_s, one.east_m, one.north_m) for one in moments])  # type: ignore[attr-defined]
    return np.column_stack([np.interp(times_s, known[:, 0], known[:, axis]) for axis in (1, 2)])


def _animated(seconds: float, timing: str = "", **values: Iterable[float]) -> Iterator[str]:
    """Return the motion of a shape's attributes, each of which takes its values one after the other."""
    for name, several in values.items():
        listed = ";".join(f"{value:.1f}" for value in several)
        repeat = f'{timing} dur="{seconds:.1f}s" repeatCount="indefinite"'
        yield f'<animate attributeName="{name}" values="{listed}"{repeat}/>'


def _moving(points: np.ndarray, kind: str, seconds: float, shape: str) -> Iterator[str]:
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    repeat = f'dur="{seconds:.1f}s" repeatCount="indefinite"'
    yield f'<g class="{kind}"><path class="faint" d="{path}"/>'
    values = ";".join(f"{x:.1f},{y:.1f}" for x, y in points)
    motion = f'<animateMotion values="{values}" calcMode="linear" rotate="auto" {repeat}/>'
    yield f"<{shape}>{motion}</{shape.split(maxsplit=1)[0]}></g>"


def _sight(aircraft: np.ndarray, target: np.ndarray, seconds: float) -> Iterator[str]:
    (x1, y1), (x2, y2) = aircraft.T, target.T
    yield '<line class="target" stroke-dasharray="4 4" opacity=".6">'
    yield from _animated(seconds, x1=x1, y1=y1, x2=x2, y2=y2)
    yield "</line>"


def _circles(flight: FlownTrack, times_s: np.ndarray, seconds: float, placed: Placed, scale: float) -> Iterator[str]:
    """Draw the circle that is commanded at each moment: one shape that jumps."""
    begun = [(max(since_s, times_s[0]), one) for since_s, one in flight.circles if since_s < times_s[-1]]
    circles = dict(begun)  # of those from before the first moment, the last
    if not circles:
        return
    centres = placed(np.array([(one.east_m, one.north_m) for one in circles.values()]))
    moments = [f"{(since_s - times_s[0]) / (len(times_s) * _STEP_S):.4f}" for since_s in circles]
    timing = f' calcMode="discrete" keyTimes="{";".join(["0", *moments[1:]])}"'
    yield '<circle class="now" stroke-width="2">'
    radii = [scale * one.radius_m for one in circles.values()]
    yield from _animated(seconds, timing, cx=centres[:, 0], cy=centres[:, 1], r=radii)
    yield "</circle>"


def _legend(scale: float, height: float) -> Iterator[str]:
    long_m = 100.0
    y = height - 12.0
    yield f'<path d="M{_MARGIN} {y}h{long_m * scale:.1f}"/><text x="{_MARGIN}" y="{y - 5}">{long_m:.0f} m</text>'
    yield f'<g transform="translate({_WIDTH - 24} 34)"><path class="solid" d="M0 -14L5 4L0 0L-5 4Z"/>'
    yield '<text x="-4" y="18">N</text></g>'
    for place, (kind, words) in enumerate(
        (("aircraft", "aircraft"), ("target", "target and line of sight"), ("now", "commanded circle"))
    ):
        yield f'<text class="{kind}" x="{_MARGIN + 170 * place}" y="20">{words}</text>'

"""What Foxglove's 3D panel draws: lines and a ball, each an entity that the next one of its name replaces."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

Place = tuple[float, float, float]
"""East, north and height above home, m."""

_LINE_STRIP = 0
_FOREVER = {"sec": 0, "nsec": 0}
_SHAPES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_NO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_COLOURS = {
    "target": (0.85, 0.15, 0.10, 1.0),
    "ellipse": (0.85, 0.15, 0.10, 1.0),
    "sight": (0.95, 0.75, 0.10, 0.8),
    "circle": (0.10, 0.55, 0.90, 1.0),
    "route": (0.95, 0.80, 0.20, 0.6),
    "plan": (0.55, 0.35, 0.85, 1.0),
}
_LINE_PIXELS = {"sight": 1.0}
_BALL_M = 4.0


def line(name: str, places: Iterable[Place]) -> dict[str, Any]:
    """Return the entity ``name`` as a line through the places, in the frame ``plane``."""
    return _entity(
        name,
        lines=[
            {
                "type": _LINE_STRIP,
                "pose": _pose((0.0, 0.0, 0.0)),
                "thickness": _LINE_PIXELS.get(name, 3.0),
                "scale_invariant": True,
                "points": [_xyz(place) for place in places],
                "color": _colour(name),
                "colors": [],
                "indices": [],
            }
        ],
    )


def ball(name: str, place: Place) -> dict[str, Any]:
    """Return the entity ``name`` as a ball at the place."""
    sphere = {"pose": _pose(place), "size": _xyz((_BALL_M, _BALL_M, _BALL_M)), "color": _colour(name)}
    return _entity(name, spheres=[sphere])


def _entity(name: str, **shapes: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "frame_id": "plane",
        "id": name,
        "lifetime": _FOREVER,
        "frame_locked": True,
        "metadata": [],
        **{shape: shapes.get(shape, []) for shape in _SHAPES},
    }


def _pose(place: Place) -> dict[str, Any]:
    return {"position": _xyz(place), "orientation": _NO_ROTATION}


def _xyz(place: Place) -> dict[str, float]:
    return dict(zip("xyz", map(float, place), strict=True))


def _colour(name: str) -> dict[str, float]:
    return dict(zip("rgba", _COLOURS[name], strict=True))

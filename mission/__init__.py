"""Where to fly: circles next to the target, the transitions between them, and when to move.

Pure: time comes in as an argument, nothing here reads a clock, a socket or a file. Frames, units and the
clock are those of :mod:`estimators`.

Signs
-----
curvature_per_m    change of course per metre flown; positive turns right (clockwise seen from above).
clockwise        direction of flight round a circle, seen from above; its curvature is +1/radius.
left, right      of the target's direction of motion.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sidelong.mission.core.circle import Circle
    from sidelong.mission.core.plan import AircraftState, Decision, Plan, Planner
    from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
    from sidelong.mission.paper.planner import PaperPlanner
    from sidelong.mission.predictive.planner import PredictivePlanner

# What a researcher imports from here; each is loaded when it is first used.
_HOMES = {
    "Aircraft": "core.requirement",
    "AircraftState": "core.plan",
    "Circle": "core.circle",
    "Decision": "core.plan",
    "PaperPlanner": "paper.planner",
    "Plan": "core.plan",
    "Planner": "core.plan",
    "PredictivePlanner": "predictive.planner",
    "Requirement": "core.requirement",
    "Side": "core.requirement",
    "Wind": "core.requirement",
}
__all__ = [
    "Aircraft",
    "AircraftState",
    "Circle",
    "Decision",
    "PaperPlanner",
    "Plan",
    "Planner",
    "PredictivePlanner",
    "Requirement",
    "Side",
    "Wind",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

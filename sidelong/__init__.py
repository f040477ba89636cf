"""Watch a moving ground target from one side with a fixed-wing UAV.

The packages, from the shell down to the core:

app         command line, link to the autopilot, control loop, records, replay and views
mission     circles, transitions, planners, the exchange with the autopilot and the control step
estimators  frames, sensors, target filters and tracks
sitl        a simulated vehicle, target and payload; it shares no code with the other three

The names below are the public interface for programs. Each is imported when it is first used.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING

if not os.path.isdir(os.path.join(os.path.dirname(__file__), "app")):  # noqa: PTH112, PTH118, PTH120  # faster
    raise SystemExit(
        "sidelong: this copy has files in place of the links sidelong/app, estimators, mission and sitl; make the "
        "links with: git config core.symlinks true && git checkout -- sidelong (on Windows with developer mode on)"
    )

if TYPE_CHECKING:
    from sidelong.app.api import FlightError, InputError, Watch, watch
    from sidelong.estimators.estimate import TargetEstimate
    from sidelong.estimators.frames import LocalPlane
    from sidelong.estimators.sensing.sighting import Sighting
    from sidelong.estimators.settings import TrackerSettings
    from sidelong.estimators.tracking.track import Track
    from sidelong.estimators.tracking.tracker import Tracker
    from sidelong.mission.core.circle import Circle
    from sidelong.mission.core.plan import AircraftState, Decision, Plan, Planner
    from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
    from sidelong.mission.paper.planner import PaperPlanner
    from sidelong.mission.predictive.planner import PredictivePlanner

__all__ = [
    "Aircraft",
    "AircraftState",
    "Circle",
    "Decision",
    "FlightError",
    "InputError",
    "LocalPlane",
    "PaperPlanner",
    "Plan",
    "Planner",
    "PredictivePlanner",
    "Requirement",
    "Side",
    "Sighting",
    "TargetEstimate",
    "Track",
    "Tracker",
    "TrackerSettings",
    "Watch",
    "Wind",
    "watch",
]
_NAMES = {
    "app.api": ("FlightError", "InputError", "Watch", "watch"),
    "estimators.estimate": ("TargetEstimate",),
    "estimators.frames": ("LocalPlane",),
    "estimators.sensing.sighting": ("Sighting",),
    "estimators.settings": ("TrackerSettings",),
    "estimators.tracking.track": ("Track",),
    "estimators.tracking.tracker": ("Tracker",),
    "mission.core.circle": ("Circle",),
    "mission.core.plan": ("AircraftState", "Decision", "Plan", "Planner"),
    "mission.core.requirement": ("Aircraft", "Requirement", "Side", "Wind"),
    "mission.paper.planner": ("PaperPlanner",),
    "mission.predictive.planner": ("PredictivePlanner",),
}


def __getattr__(name: str) -> object:
    for home, names in _NAMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

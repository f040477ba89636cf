"""Watch a moving ground target from one side with a fixed-wing UAV.

The packages, from the shell down to the core:

app         command line, link to the autopilot, control loop, records, replay and views
mission     circles, transitions, planners, the exchange with the autopilot and the control step
estimators  frames, sensors, target filters and tracks
sitl        a simulated vehicle, target and payload; it shares no code with the other three

The names below are the public interface for programs. Each is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sidelong.app.api import FlightError, InputError, Watch, watch
    from sidelong.estimators import LocalPlane, Sighting, TargetEstimate, Track, Tracker, TrackerSettings
    from sidelong.mission import (
        Aircraft,
        AircraftState,
        Circle,
        Decision,
        PaperPlanner,
        Plan,
        Planner,
        PredictivePlanner,
        Requirement,
        Side,
        Wind,
    )

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


def __getattr__(name: str) -> object:
    for package in ("estimators", "mission", "app.api"):
        home = import_module(f"{__name__}.{package}")
        if name in home.__all__:
            return getattr(home, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""What a change in flight does. Source: docs/how-to/maps.md#change-the-mission-in-flight."""

from __future__ import annotations

import math
from dataclasses import replace

from sidelong.mission.core.events import MissionChange
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.viewpoint.watch_course import watching_from


def requirement_after(change: MissionChange, requirement: Requirement) -> Requirement:
    """Return the requirement after a change; ValueError: the words for the side are invalid."""
    min_m = requirement.range_min_m if change.range_min_m is None else change.range_min_m
    max_m = requirement.range_max_m if change.range_max_m is None else change.range_max_m
    banded = replace(requirement, range_min_m=min_m, range_max_m=max_m)
    return banded if change.side is None else watching_from(banded, change.side)


def aircraft_after(change: MissionChange, aircraft: Aircraft) -> Aircraft:
    """Return the aircraft's limits after a change."""
    radius_m = aircraft.radius_m if change.radius_m is None else change.radius_m
    pan_rad = aircraft.pan_limit_rad if change.pan_limit_deg is None else math.radians(change.pan_limit_deg)
    return replace(aircraft, radius_m=radius_m, pan_limit_rad=pan_rad)


def describe_change(change: MissionChange) -> str:
    """Return a change in words."""
    words = (
        ("radius {:g} m", change.radius_m),
        ("least range {:g} m", change.range_min_m),
        ("greatest range {:g} m", change.range_max_m),
        ("height {:g} m", change.height_m),
        ("side {}", change.side),
        ("pan limits of +-{:g} degrees", change.pan_limit_deg),
    )
    return ", ".join(form.format(value) for form, value in words if value is not None)

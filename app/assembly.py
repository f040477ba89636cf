"""Puts the pure core together from a configuration."""

from __future__ import annotations

import math
from collections.abc import Callable

from app.config import Config
from app.value_cache import value_table
from estimators.tracker import SourceChoice, Tracker, TrackerSettings
from mission.paper_planner import PaperPlanner
from mission.plan import Planner
from mission.predictive_planner import PredictivePlanner, PredictiveSettings, table_configuration
from mission.requirement import Requirement
from mission.watch import Watch, WatchSettings

# Lasers miss for a second or two all the time; that is nothing to tell anybody.
_COASTING_AFTER_S = 3.0


def tracker_of(config: Config) -> Tracker:
    """Return the target tracker for the configured sensors."""
    sensors = config.sensors

    def chosen(component_id: int | None) -> SourceChoice | None:
        return None if component_id is None else SourceChoice(component_id=component_id)

    return Tracker(
        TrackerSettings(
            filter=sensors.filter,
            range_sigma_m=sensors.range_sigma_m,
            yaw_sigma_rad=math.radians(sensors.angle_sigma_deg),
            pitch_sigma_rad=math.radians(sensors.angle_sigma_deg),
            latency_s=sensors.latency_s,
            range_source=chosen(sensors.range_component),
            gimbal_source=chosen(sensors.gimbal_component),
            coasting_after_s=_COASTING_AFTER_S,
            lost_after_s=config.planner.lost_after_s,
        )
    )


def watch_of(config: Config, progress: Callable[[float], None] = lambda _share: None) -> Watch:
    """Return the control step for a configuration.

    progress hears of the value table's computation, which takes some seconds once per configuration.
    """
    aircraft = config.aircraft.aircraft()
    requirement = config.requirement.requirement()
    settings = PredictiveSettings(lost_after_s=config.planner.lost_after_s)

    def planner(wanted: Requirement) -> Planner:
        if config.planner.name == "paper":
            return PaperPlanner(aircraft, wanted)
        table = value_table(table_configuration(aircraft, wanted), progress)
        return PredictivePlanner(aircraft, wanted, table, settings)

    return Watch(
        WatchSettings(
            requirement,
            aircraft,
            lost_after_s=config.planner.lost_after_s,
            give_up_after_s=config.planner.give_up_after_s,
            give_up_action=config.planner.at_end,
        ),
        tracker_of(config),
        planner,
    )

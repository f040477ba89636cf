"""Constants of joint decisions. Source: docs/explanation/planners.md#several-aircraft."""

from __future__ import annotations

import numpy as np

from sidelong.mission.core.requirement import Side
from sidelong.mission.fleet.team_kernel import Team
from sidelong.mission.predictive.planner import PRICE_SHARE, PredictiveSettings
from sidelong.mission.predictive.value_table import ValueTable

# A circle that takes more of the band swings further about the target: predictions of the others are worth less.
_WIDE, _WIDER_POWER = 1.0 / 7.0, 3
# The share of the band that the fastest target crosses in a lap: where it is more, a circle is left sooner anyway.
_CROSSED = 0.43
# Where other aircraft watch during a move, cheaper moves than those of this share are too frequent in the tables. A
# remaining aircraft keeps these, as others may join it. By tight turns one gets back to the side sooner where a turn
# of the target has put all of them off it. Another can look where one is beyond its pan limit.
IN_TEAM = PredictiveSettings(min_share=PRICE_SHARE, turn_share=0.5, keeps_pan_limits=False)
_DIRECTIONS_RAD = np.radians(np.arange(-168.75, 180.0, 22.5))


def team_of(table: ValueTable, wanted: Side) -> Team:
    """Return what the loops decide with.

    Fast targets lower ``price`` and raise ``opposite``; wide circles raise ``own``.

    Raises:
        ValueError: The table is that of a sector.
    """
    configuration = table.configuration
    if not configuration.follows_course:
        raise ValueError("several aircraft share the sides of a target, not a sector")
    habits, cost = configuration.habits, configuration.cost
    wide = configuration.radius_m / (_WIDE * (cost.far_m - cost.near_m))
    lap_s = 2.0 * np.pi * configuration.radius_m / configuration.airspeed_m_s
    crossed = lap_s * configuration.target_speed_max_m_s / (cost.far_m - cost.near_m)
    haste = max(1.0, crossed / _CROSSED)
    return Team(
        wanted=1.0 if wanted is Side.LEFT else -1.0,
        turns_rad=np.radians(habits.turns_deg),
        chances=np.array(habits.chances),
        alone_running=0.2,
        alone_end=0.2,
        price=0.6 / haste,
        opposite=0.6 * haste,
        turn=2.0,
        margin=0.5,
        own=max(1.0, wide**_WIDER_POWER),
    )


def next_to_standing(team: Team) -> Team:
    """Return what to decide with while the target stands: it may set out into any direction."""
    return team._replace(turns_rad=_DIRECTIONS_RAD, chances=np.full(_DIRECTIONS_RAD.size, 1.0 / _DIRECTIONS_RAD.size))

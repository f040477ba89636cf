"""What a run of a study is flown with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from sidelong.app.config import Config, with_values
from sidelong.app.planners.registry import PLANNER_NAMES
from sidelong.app.study.recorded import RecordedTarget
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground


PREDICTIVE, PAPER = "predictive", "paper"
LAWS = LVFG, PARK, ORBIT = "lvfg", "park", "orbit"
"""Guidance laws of the literature, which steer an aircraft directly."""
CONTROLLER = "controller"
"""A program of the user."""
MISSION_PLANNERS = PLANNER_NAMES
"""The planners that the closed loop flies, those of other distributions included."""
OWN_PLANNERS = (PREDICTIVE, PAPER, *LAWS)
"""What the benchmark compares without a program of the user."""

PARTS = (
    "MAVLink decoding, plausibility checks, filter, planner, control step and exchange with the autopilot; a "
    "simulated vehicle flies the uploaded mission items by its own guidance"
)
"""What a study consists of."""

# Fitted to the bank that flights in SITL asked for and flew, a quarter of an hour each (to 0.045 and 0.011 rad RMS).
LAG_S = {"arduplane": 0.45, "px4": 0.43}
"""Time constant of the bank of each autopilot."""

# What of the configuration shapes a run; the rest is about links, fences and real vehicles.
SHAPING = {
    "aircraft": (
        *("airspeed_m_s", "radius_m", "bank_max_deg", "roll_rate_max_deg_s", "height_m"),
        *("clearance_m", "climb_m_s", "descent_m_s", "pan_limit_deg"),
    ),
    "requirement": ("range_min_m", "range_max_m", "side", "target_speed_max_m_s", "threshold", "course_horizon_s"),
    "planner": ("lost_after_s",),
    "sensors": (
        *("range_sigma_m", "angle_sigma_deg", "yaw_bias_sigma_deg", "pitch_bias_sigma_deg", "range_bias_sigma_m"),
        *("filter", "target_kind"),
    ),
    "simulation": ("wind_speed_m_s", "wind_from_deg"),
}
# The paper's requirement with the threshold that keeps the band longest.
STUDIED = Config.model_validate(
    {
        "aircraft": {"airspeed_m_s": 10.0, "radius_m": 50.0},
        "requirement": {"target_speed_max_m_s": 5.0, "threshold": 1.0},
    }
)


def shaping(config: Config) -> dict[str, dict[str, Any]]:
    """Return what of a configuration shapes a run, as plain values by section and key."""
    return config.model_dump(mode="json", include={section: {*keys} for section, keys in SHAPING.items()})


def studied(**values: Any) -> Config:
    """Return the configuration of a study with other values, by the names of their keys."""
    allowed = SHAPING | {"requirement": (*SHAPING["requirement"], "fleet_size")}
    sections = {name: {key: values[key] for key in keys if key in values} for name, keys in allowed.items()}
    return with_values(STUDIED, sections, "study")


@dataclass(frozen=True, slots=True, eq=False)
class StudyTerrain:
    """The ground of a study about home, and a digest of it."""

    ground: Ground
    digest: str


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What is flown, and how often.

    planners: what is compared. config: aircraft, requirement, sensors and wind. runs: targets; each is flown
    noise_draws times by each planner. legs_s: how long a random target keeps its course. perfect_sensors: laser and
    gimbal have no errors. lag_s: time constant with which the bank follows its command, within the roll rate; 0: that
    of the autopilot. tracks: recorded targets in place of random ones, as many as runs, each flown to its end or
    for duration_s; skipped: (file, reason) of others. only: numbers of the runs to be flown, not all. layer_m: from
    the height of an aircraft of a fleet to that of the next.

    autopilot: whose vehicle flies. controller: the command of the planner
    "controller", see :mod:`sidelong.app.study.controller`.

    hills: what targets and aircraft move over, None: flat ground. terrain: whether planner and filter know it.
    """

    planners: tuple[str, ...] = OWN_PLANNERS
    runs: int = 20
    seed: int = 1
    config: Config = STUDIED
    legs_s: tuple[float, float] = (40.0, 200.0)
    perfect_sensors: bool = False
    duration_s: float = 1200.0
    lag_s: float = 0.0
    tracks: tuple[RecordedTarget, ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()
    noise_draws: int = 1
    only: tuple[int, ...] = ()
    layer_m: float = 60.0
    hills: StudyTerrain | None = None
    terrain: Literal["known", "ignored"] = "known"
    autopilot: str = "arduplane"
    controller: str = ""

    @property
    def numbers(self) -> Sequence[int]:
        """The runs of each planner: every target once, then again with other noise."""
        return self.only or range(self.runs * self.noise_draws)

    @property
    def still_air_radius_m(self) -> float:
        """Radius of a circle in still air with the bank of the configured one at its greatest ground speed."""
        aircraft, wind_m_s = self.config.aircraft, self.config.simulation.wind_speed_m_s
        return round(aircraft.radius_m / (1.0 + wind_m_s / aircraft.airspeed_m_s) ** 2, 9)

    @property
    def wind(self) -> Wind:
        speed_m_s, from_deg = self.config.simulation.wind_speed_m_s, self.config.simulation.wind_from_deg
        if from_deg == 270.0:
            return Wind(speed_m_s, 0.0)
        return Wind(-speed_m_s * math.sin(math.radians(from_deg)), -speed_m_s * math.cos(math.radians(from_deg)))

    def aircraft(self) -> Aircraft:
        return self.config.aircraft.aircraft()

    def requirement(self) -> Requirement:
        return self.config.requirement.requirement()

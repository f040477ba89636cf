"""What a run of a study is flown with, and the designs of a study: one for each combination of swept parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from sidelong.app.config import Config, with_values
from sidelong.app.errors import InputError
from sidelong.app.planners.registry import PLANNER_NAMES
from sidelong.app.study.recorded import RecordedTarget
from sidelong.mission.core.feasibility import in_words, unflyable
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground


PREDICTIVE, PAPER = "predictive", "paper"
LAWS = LVFG, PARK, ORBIT = "lvfg", "park", "orbit"
"""Guidance laws of the literature, which steer an aircraft directly."""
CONTROLLER = "controller"  # a program of the user
MISSION_PLANNERS = PLANNER_NAMES  # the planners that the closed loop flies, those of other distributions included
OWN_PLANNERS = (PREDICTIVE, PAPER, *LAWS)  # what the benchmark compares without a program of the user

PARTS = (
    "MAVLink decoding, plausibility checks, filter, planner, control step and exchange with the autopilot; a "
    "simulated vehicle flies the uploaded mission items by its own guidance"
)  # what a study consists of

# Fitted to the bank that flights in SITL asked for and flew, a quarter of an hour each (to 0.045 and 0.011 rad RMS).
LAG_S = {"arduplane": 0.45, "px4": 0.43}  # time constant of the bank of each autopilot

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
    "simulation": ("wind_speed_m_s", "wind_from_deg", "turbulence"),
}
# The paper's requirement with the threshold that keeps the band longest.
STUDIED = Config.model_validate(
    {
        "aircraft": {"airspeed_m_s": 10.0, "radius_m": 50.0},
        "requirement": {"target_speed_max_m_s": 5.0, "threshold": 1.0},
    }
)


def shaping(config: Config) -> dict[str, dict[str, Any]]:
    """Return the values that the result of a study depends on, by section and key."""
    return config.model_dump(mode="json", include={section: {*keys} for section, keys in SHAPING.items()})


def studied(**values: Any) -> Config:
    """Return the configuration of a study with some keys changed; a name stands for its key in every section."""
    allowed = SHAPING | {"requirement": (*SHAPING["requirement"], "fleet_size")}
    sections = {name: {key: values[key] for key in keys if key in values} for name, keys in allowed.items()}
    return with_values(STUDIED, sections, "study")


@dataclass(frozen=True, slots=True, eq=False)
class StudyTerrain:
    ground: Ground
    digest: str


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What is flown, and how often: each of ``runs`` targets noise_draws times by each planner.

    Attributes:
        legs_s: how long a random target keeps its course.
        lag_s: time constant of the bank towards its command, within the roll rate; 0: that of the autopilot.
        tracks: recorded targets in place of random ones, each flown to its end or for duration_s.
        skipped: (file, reason) of others.
        only: numbers of the runs to be flown; (): all.
        layer_m: from the height of an aircraft of a fleet to that of the next.
        hills: what targets and aircraft move over, None: flat ground.
        terrain: whether planner and filter know it.
        controller: the command of the planner "controller", see :mod:`sidelong.app.study.laws`.
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
        """The mean wind, as a velocity."""
        speed_m_s, from_deg = self.config.simulation.wind_speed_m_s, self.config.simulation.wind_from_deg
        if from_deg == 270.0:
            return Wind(speed_m_s, 0.0)
        return Wind(-speed_m_s * math.sin(math.radians(from_deg)), -speed_m_s * math.cos(math.radians(from_deg)))

    def aircraft(self) -> Aircraft:
        return self.config.aircraft.aircraft()

    def requirement(self) -> Requirement:
        return self.config.requirement.requirement()


Value = float | str
Overrides = dict[str, dict[str, Any]]

SWEPT = SHAPING | {"study": ("lag_s", "terrain")}
_DESIGNS_MAX = 10_000
_LAG_MAX_S = 5.0
_ROOMY_RADIUS_M = 105.0  # the widest circle that leaves room in the band of 100 to 500 m


@dataclass(frozen=True, slots=True)
class Design:
    """swept: this design's values of the swept parameters, in the order they were given."""

    settings: StudySettings
    swept: tuple[tuple[str, Value], ...] = ()

    def __str__(self) -> str:
        return ", ".join(f"{key}={word(value)}" for key, value in self.swept)


def word(value: Value) -> str:
    """Return a value of a sweep as it is printed."""
    return f"{value:g}" if isinstance(value, float) else value


def parsed_sweep(words: str) -> tuple[str, tuple[Value, ...]]:
    """Return parameter and values of ``KEY=V1,V2`` or ``KEY=FROM:TO:STEP``, ends included. Raises InputError."""
    key, equals, text = words.partition("=")
    key = key.strip()
    section, _, field = key.partition(".")
    if not equals or not text.strip():
        raise InputError(f"--sweep: {words!r} is not of the form KEY=V1,V2 or KEY=FROM:TO:STEP.")
    if field not in SWEPT.get(section, ()):
        known = ", ".join(f"{section}.{field}" for section, fields in SWEPT.items() for field in fields)
        raise InputError(f"--sweep: {key} is no parameter that shapes a study; these are: {known}.")
    if ":" in text:
        return key, _stepped(words, text)
    return key, tuple(dict.fromkeys(_value(one.strip()) for one in text.split(",")))


def _stepped(words: str, text: str) -> tuple[Value, ...]:
    try:
        first, last, step = map(float, text.split(":"))
        count = math.floor((last - first) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        count = 0
    if count < 1:
        raise InputError(f"--sweep: {words!r} has no values; FROM:TO:STEP is like 300:600:50.")
    if count > _DESIGNS_MAX:
        raise InputError(f"--sweep: {words!r} has more than {_DESIGNS_MAX} values; give a larger STEP.")
    return tuple(round(first + k * step, 9) for k in range(count))


def _value(word: str) -> Value:
    try:
        return float(word)
    except ValueError:
        return word


def designs(
    base: StudySettings,
    overrides: Overrides,
    sweeps: list[tuple[str, tuple[Value, ...]]],
    skip: Callable[[str], None] = lambda _words: None,
) -> tuple[Design, ...]:
    """Return the designs of every combination of the swept values over what is configured.

    overrides: the configured values by section and key, the study's own under ``study``. Combinations that no planner
    can fly are passed to ``skip``. Raises InputError for a wrong value, and where none is left.
    """
    if math.prod(len(values) for _, values in sweeps) > _DESIGNS_MAX:
        raise InputError(f"--sweep: more than {_DESIGNS_MAX} combinations; sweep fewer values.")
    found, refused = [], []
    for values in itertools.product(*(values for _, values in sweeps)):
        swept = tuple(zip((key for key, _ in sweeps), values, strict=True))
        given: Overrides = {section: dict(keys) for section, keys in overrides.items()}
        for key, value in swept:
            section, _, field = key.partition(".")
            given.setdefault(section, {})[field] = value
        settings = _settings(base, given, "--sweep" if sweeps else "command line")
        design = Design(settings, swept)
        reasons = unflyable(settings.aircraft(), settings.requirement())
        if not reasons:
            found.append(design)
            continue
        refused.append((design, f"infeasible: {in_words(reasons)}"))
    if not found:
        raise InputError(f"{refused[0][1]}.")
    for design, why in refused:
        skip(f"skipped {design}: {why}")
    return tuple(found)


def configured(config: Config) -> Overrides:
    """Return what of a mission's configuration shapes a run, as overrides; a radius "auto" fits what is swept."""
    found = shaping(config)
    found["aircraft"]["radius_m"] = config.radius_words
    return found


def _settings(base: StudySettings, given: Overrides, name: str) -> StudySettings:
    own, of_config = given.get("study", {}), {section: keys for section, keys in given.items() if section != "study"}
    config = with_values(base.config, of_config, name)
    airspeed_m_s, wind_m_s = config.aircraft.airspeed_m_s, config.simulation.wind_speed_m_s
    if wind_m_s > 0.7 * airspeed_m_s:
        raise InputError(
            f"a wind of {wind_m_s:g} m/s is above 0.7 of the airspeed, {0.7 * airspeed_m_s:g} m/s, which is the most "
            "that is studied; lower simulation.wind_speed_m_s, or raise aircraft.airspeed_m_s."
        )
    fitted: Overrides = {}
    if "radius_m" not in given.get("aircraft", {}):
        # In wind the circle grows, so that its bank at the greatest ground speed stays.
        still_air_radius_m = min(50.0 * max(1.0, (airspeed_m_s / 10.0) ** 2), _ROOMY_RADIUS_M)
        fitted["aircraft"] = {"radius_m": still_air_radius_m * (1.0 + wind_m_s / airspeed_m_s) ** 2}
    if "target_speed_max_m_s" not in given.get("requirement", {}):
        fitted["requirement"] = {"target_speed_max_m_s": 0.5 * airspeed_m_s}
    lag_s = own.get("lag_s", base.lag_s)
    if not isinstance(lag_s, float | int) or not 0.0 <= lag_s <= _LAG_MAX_S:
        raise InputError(f"study.lag_s: {lag_s} s is not from 0 to {_LAG_MAX_S:g} s.")
    terrain = own.get("terrain", base.terrain)
    if terrain not in ("known", "ignored") or (terrain != base.terrain and base.hills is None):
        raise InputError("--sweep: study.terrain is known or ignored, and needs --terrain.")
    config = with_values(config, fitted, name)
    return replace(base, config=config, lag_s=float(lag_s), terrain=terrain)

"""The designs of a study: one for each combination of the swept parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from sidelong.app.config import Config, with_values
from sidelong.app.errors import InputError
from sidelong.app.study.settings import SHAPING, StudySettings, shaping
from sidelong.mission.core.feasibility import in_words, unflyable

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
    """Return a value of a swept parameter in words."""
    return f"{value:g}" if isinstance(value, float) else value


def parsed_sweep(words: str) -> tuple[str, tuple[Value, ...]]:
    """Return the parameter and the values of ``KEY=V1,V2`` or ``KEY=FROM:TO:STEP``, ends included.

    Raises InputError.
    """
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

    overrides: the configured values by section and key, the study's own under ``study``. Combinations that no
    planner can fly are passed to ``skip``. Raises InputError for a wrong value, for a single design that
    cannot be flown, and where none is left.
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
    """Return the settings; every value is checked as the configuration's."""
    own, of_config = given.get("study", {}), {section: keys for section, keys in given.items() if section != "study"}
    config = with_values(base.config, of_config, name)
    airspeed_m_s, wind_m_s = config.aircraft.airspeed_m_s, config.simulation.wind_speed_m_s
    if wind_m_s > 0.7 * airspeed_m_s:
        raise InputError(
            f"a wind of {wind_m_s:g} m/s is above 0.7 of the airspeed, {0.7 * airspeed_m_s:g} m/s, which is the most "
            "that is studied; lower simulation.wind_speed_m_s (--wind), or raise aircraft.airspeed_m_s."
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

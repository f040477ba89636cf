"""``sidelong check``: whether this aircraft can keep this requirement with the configured planner."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from sidelong.app.commands.options import AIRCRAFT, Overrides, RadiusOption, SetOption, changed_keys, panel
from sidelong.app.commands.output import JsonOption, checked_output, console, print_notes, say, write_json
from sidelong.app.commands.progress import table_progress
from sidelong.app.config import (
    Config,
    check_alone,
    load_config,
    reach_warning,
    room_warning,
    setting_notes,
    unflyable,
)
from sidelong.app.config_files import check_files
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import load_fleet, names_a_fleet
from sidelong.app.planners.registry import PLANNER_NAMES
from sidelong.app.study.prediction import FLIGHT_S, predict
from sidelong.app.study.study import is_compiled
from sidelong.mission.paper.scope import ThresholdBounds, scope, threshold_bounds
from sidelong.mission.paper.scope import optimise as optimum

_PUBLISHED = panel("Published method (planner paper)")

_PAPER = "paper"
_AIRSPEEDS_M_S = 8.0, 30.0  # among which --optimise searches
_LABELS = {
    "x_tr_m": ("advance of one turn of the transition (x_tr)", "m"),
    "shortest_time_s": ("shortest time between moves (t_y,min)", "s"),
    "shortest_move_m": ("shortest move of the circle", "m"),
    "longest_move_m": ("longest move of the circle", "m"),
    "straight_left_m": ("straight part left for correcting the course", "m"),
    "min_threshold": ("least threshold C that works", ""),
}


def check(
    config: Annotated[Path | None, typer.Argument(help="Configuration (TOML).")] = None,
    airspeed: Annotated[float | None, AIRCRAFT(help="Airspeed, m/s.")] = None,
    radius: RadiusOption = None,
    target_speed: Annotated[float | None, AIRCRAFT(help="Highest speed of the target, m/s.")] = None,
    planner: Annotated[
        str | None, AIRCRAFT(help=f"{' or '.join(PLANNER_NAMES)}; the configured one by default.")
    ] = None,
    optimise: Annotated[
        bool, _PUBLISHED("--optimise", help="Paper: also find the best threshold and airspeed, 8 to 30 m/s.")
    ] = False,
    set_: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Check whether the configured planner can keep the requirement, and name the number to change if it cannot.

    The planner judges the numbers; then 20 short flights next to random targets are simulated, and the time in the
    range band and on the required side is printed with its confidence interval. Each aircraft of a fleet file is
    checked. A file that the configuration names and that cannot be used is reported first.

    For example:
      sidelong check
      sidelong check mission.toml
      sidelong check mission.toml --planner paper --optimise
      sidelong check --airspeed 10 --radius 50 --target-speed 3 --set requirement.range_max_m=400
    """
    checked_output(json)
    overrides: Overrides = {
        "aircraft": {"airspeed_m_s": airspeed, "radius_m": radius},
        "requirement": {"target_speed_max_m_s": target_speed},
        "planner": {"name": planner},
    }
    overrides = changed_keys(set_, overrides)
    airspeeds_m_s = _AIRSPEEDS_M_S if optimise else None
    if not names_a_fleet(config):
        settings = load_config(config, overrides)
        check_alone(settings)
        check_files(settings)
        print_notes(setting_notes(settings))
        values, reasons = _checked(settings, airspeeds_m_s)
        write_json(json, values)
        if reasons:
            raise InputError(f"infeasible: {reasons}.")
        console.print("feasible")
        return
    fleet = load_fleet(config, overrides)
    check_files(fleet, fleet.target)
    print_notes(setting_notes(fleet))
    all_values, refused = [], []
    for member in fleet.members:
        console.print(f"{member.name}, at {member.config.aircraft.height_m:g} m:")
        values, reasons = _checked(member.config, airspeeds_m_s)
        all_values.append({"name": member.name, **values})
        refused += [f"{member.name}: {reasons}"] if reasons else []
    write_json(json, {"feasible": not refused, "aircraft": all_values})
    if refused:
        raise InputError(f"infeasible: {'; '.join(refused)}.")
    console.print("feasible, names, links and heights too")


def _checked(settings: Config, airspeeds_m_s: tuple[float, float] | None) -> tuple[dict[str, Any], str]:
    """Print what one aircraft can do.

    Args:
        settings: The mission.
        airspeeds_m_s: Airspeed range in which to search for the paper's best airspeed; None: no search.

    Returns:
        The values for the JSON summary, and why the requirement cannot be met, '' if it can.
    """
    if airspeeds_m_s is not None and settings.planner.name != _PAPER:
        raise InputError(f"--optimise finds the best numbers of the paper's method; add --planner {_PAPER}.")
    reasons = unflyable(settings)
    print_notes((room_warning(settings), reach_warning(settings)))
    values: dict[str, Any] = {"planner": settings.planner.name, "prediction": None}
    if settings.planner.name == _PAPER:
        values |= _paper_values(settings, airspeeds_m_s)
    if not reasons:
        if not is_compiled(settings.planner.name):
            console.print("compiling the simulated flights, once for this version of the program: up to a minute")
        prediction = predict(settings, table_progress(console.print))
        values["prediction"] = prediction.as_json()
        console.print(f"predicted from {prediction.flights} simulated flights of {FLIGHT_S / 60.0:.0f} minutes:")
        say(f"  time in band  {prediction.time_in_band or '-'}")
        say(f"  time on side  {prediction.time_on_side or '-'}")
        if not settings.simulation.laser:
            say("  these flights have a laser; without one, expect about 1 point less on side")
        if prediction.time_within_pan_limits is not None:
            say(f"  time within the pan limits  {prediction.time_within_pan_limits}")
        reasons = prediction.shortcoming(settings)
        if prediction.doubt():
            say(f"close to the limit: {prediction.doubt()}")
    return {"feasible": not reasons, **values}, reasons


def _paper_values(settings: Config, airspeeds_m_s: tuple[float, float] | None) -> dict[str, Any]:
    """Print the paper's own quantities, and the best ones if they are asked for; return them."""
    aircraft, requirement = settings.aircraft.aircraft(), settings.requirement.requirement()
    values: dict[str, Any] = asdict(scope(aircraft, requirement))
    console.print(_table(values))
    if airspeeds_m_s is not None:
        here = threshold_bounds(aircraft, requirement)
        best = optimum(aircraft, requirement, airspeeds_m_s)
        console.print(_bounds_words("here", here))
        if best is not None:
            console.print(
                f"best airspeed {best.aircraft.airspeed_m_s:.1f} m/s on a circle of {best.aircraft.radius_m:.1f} m; "
                f"targets up to {best.target_speed_max_m_s:.2f} m/s"
            )
        console.print(_bounds_words("there", best.bounds if best is not None else None))
        values["thresholds"] = asdict(here) if here is not None else None
        values["optimum"] = None
        if best is not None:
            flown = {"airspeed_m_s": best.aircraft.airspeed_m_s, "radius_m": best.aircraft.radius_m}
            bounds, fastest_m_s = asdict(best.bounds), best.target_speed_max_m_s
            values["optimum"] = flown | {"bounds": bounds, "target_speed_max_m_s": fastest_m_s}
    return values


def _table(values: dict[str, Any]) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, (label, unit) in _LABELS.items():
        value = values[key]
        # A negative result is not a length: the reason is printed with the verdict.
        table.add_row(label, *(("none", "") if value < 0.0 else (f"{value:.3f}", unit)))
    return table


def _bounds_words(where: str, bounds: ThresholdBounds | None) -> str:
    if bounds is None:
        return f"{where}: no threshold C keeps the band against a straight target at top speed"
    return (
        f"{where}: any C from {bounds.least:.3f} to {bounds.greatest:.3f} keeps the band; best {bounds.best:.3f}, "
        f"which leaves {bounds.room_m:.0f} m at both ends and stays within {bounds.max_range_m:.0f} m"
    )

"""``sidelong check``: whether this aircraft can keep this requirement with the configured planner."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.table import Table

from sidelong.app.commands.options import (
    AirspeedOption,
    ConfigArgument,
    Overrides,
    PlannerOption,
    RadiusOption,
    SetOption,
    TargetSpeedOption,
    VehicleOption,
    changed_keys,
)
from sidelong.app.commands.output import (
    JsonOption,
    checked_output,
    console,
    print_notes,
    say,
    table_progress,
    write_json,
)
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
from sidelong.app.process import run
from sidelong.app.study.prediction import FLIGHT_S, predict
from sidelong.app.study.study import is_compiled
from sidelong.mission.paper.scope import scope

_PAPER = "paper"
_LABELS = {
    "x_tr_m": ("advance of one turn of the transition (x_tr)", "m"),
    "shortest_time_s": ("shortest time between moves (t_y,min)", "s"),
    "shortest_move_m": ("shortest move of the circle", "m"),
    "longest_move_m": ("longest move of the circle", "m"),
    "straight_left_m": ("straight part left for correcting the course", "m"),
    "min_threshold": ("least threshold C that works", ""),
}


def check(
    config: ConfigArgument = None,
    airspeed: AirspeedOption = None,
    radius: RadiusOption = None,
    target_speed: TargetSpeedOption = None,
    planner: PlannerOption = None,
    set_: SetOption = None,
    connect: VehicleOption = None,
    json: JsonOption = None,
) -> None:
    """Check whether the configured planner can keep the requirement, and name the number to change if it cannot.

    The planner judges the numbers; then 20 short flights next to random targets are simulated, and the time in the
    range band and on the required side is printed with its confidence interval. Each aircraft of a fleet file is
    checked. A file that the configuration names and that cannot be used is reported first.

    For example:
      sidelong check
      sidelong check mission.toml
      sidelong check mission.toml --planner paper
      sidelong check mission.toml --connect udpin://0.0.0.0:14540
      sidelong check --airspeed 10 --radius 50 --target-speed 3 --set requirement.range_max_m=400
    """
    checked_output(json)
    of_options: Overrides = {
        "aircraft": {"airspeed_m_s": airspeed, "radius_m": radius},
        "requirement": {"target_speed_max_m_s": target_speed},
        "planner": {"name": planner},
    }
    overrides = changed_keys(set_, of_options)
    fleet = load_fleet(config, overrides) if names_a_fleet(config) else None
    flown: Config = load_config(config, overrides) if fleet is None else fleet
    if fleet is None:
        check_alone(flown)
    elif connect is not None:
        raise InputError("--connect checks one aircraft; leave it out with a fleet file.")
    check_files(flown, () if fleet is None else fleet.target)
    if connect is not None:
        flown = run(_with_fences(flown, connect))
    print_notes(setting_notes(flown))
    found, refused = [], []
    checked = [("", flown)] if fleet is None else [(member.name, member.config) for member in fleet.members]
    for name, own in checked:
        if name:
            console.print(f"{name}, at {own.aircraft.height_m:g} m:")
        values, reasons = _checked(own)
        found.append({"name": name, **values} if name else values)
        refused += [f"{name}: {reasons}" if name else reasons] if reasons else []
    write_json(json, found[0] if fleet is None else {"feasible": not refused, "aircraft": found})
    if refused:
        raise InputError(f"infeasible: {'; '.join(refused)}.")
    console.print("feasible" if fleet is None else "feasible, names, links and heights too")


async def _with_fences(settings: Config, url: str) -> Config:
    from sidelong.app.flight.session import connected, with_fences  # noqa: PLC0415  # a check needs no link else
    from sidelong.app.link.stored import read_table  # noqa: PLC0415

    async with connected(settings.link.model_copy(update={"urls": [url]}), console.print) as session:
        parameters = await read_table(session.vehicle, session.autopilot, session.release)
        flown, found = await with_fences(session.vehicle, settings, parameters)
    console.print(f"the vehicle has {found}")
    return flown


def _checked(settings: Config) -> tuple[dict[str, Any], str]:
    """Print what one aircraft can do; return the JSON summary, and why the requirement is not met, '' if it is."""
    reasons = unflyable(settings)
    print_notes((room_warning(settings), reach_warning(settings)))
    values: dict[str, Any] = {"planner": settings.planner.name, "prediction": None}
    if settings.planner.name == _PAPER:
        own = asdict(scope(settings.aircraft.aircraft(), settings.requirement.requirement()))
        console.print(_table(own))
        values |= own
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


def _table(values: dict[str, Any]) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, (label, unit) in _LABELS.items():
        value = values[key]
        # A negative result is not a length: the reason is printed with the verdict.
        table.add_row(label, *(("none", "") if value < 0.0 else (f"{value:.3f}", unit)))
    return table

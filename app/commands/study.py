"""``sidelong study``: planners compared over many targets, random or recorded."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field, TypeAdapter, ValidationError

from sidelong.app.commands.options import (
    AIRCRAFT,
    OUTPUT,
    AirspeedOption,
    Overrides,
    RadiusOption,
    SetOption,
    TargetSpeedOption,
    changed_keys,
    panel,
)
from sidelong.app.commands.output import (
    JsonOption,
    checked_file,
    checked_output,
    console,
    print_whole,
    runs_progress,
    write_json,
    writing,
)
from sidelong.app.config import load_config, with_values
from sidelong.app.errors import InputError
from sidelong.app.study.benchmark import Benchmark, benchmark_table
from sidelong.app.study.fleet import FleetPlannerName, fleet_json, fleet_table, fly_fleets
from sidelong.app.study.judging import EXPLAINED
from sidelong.app.study.recorded import recorded_targets, route_next_to
from sidelong.app.study.report import (
    export_runs,
    study_json,
    study_parts,
    study_table,
    study_title,
    sweep_table,
    write_page,
)
from sidelong.app.study.settings import (
    CONTROLLER,
    LAG_S,
    LAWS,
    MISSION_PLANNERS,
    PREDICTIVE,
    SHAPING,
    Design,
    StudySettings,
    StudyTerrain,
    configured,
    designs,
    parsed_sweep,
)
from sidelong.app.study.study import (
    ResultStore,
    Study,
    StudyResult,
    Workers,
    is_compiled,
    on_cluster,
    on_processes,
    table_of,
)
from sidelong.app.terrain.elevation_data import elevation_data
from sidelong.estimators.frames import LocalPlane

_TARGETS = panel("Targets")
_COMPARISON = panel("Comparison")
_COMPUTATION = panel("Computation")

_Seconds = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
# Keys of section study: how long a random target keeps its course, whether laser and gimbal err, runs per target.
_OWN_KEYS: dict[str, TypeAdapter[Any]] = {
    "legs_s": TypeAdapter(tuple[_Seconds, _Seconds]),
    "perfect_sensors": TypeAdapter(bool),
    "noise_draws": TypeAdapter(Annotated[int, Field(ge=1)]),
}
_OF_BENCHMARK = {"benchmark", "targets", "planner", "controller", "runs", "jobs", "json"}
# What does not belong to the command that flies one run again.
_OF_WHOLE = {"planner", "run", "sweep", "store", "export", "report", "json", "jobs", "scheduler"}
_AIRSPEED_M_S = 5.0, 60.0  # of the simulated vehicle
_SCHEDULER = re.compile(r"[a-z]+://.+:\d+")
_BATCH_MAX = 50  # runs that go to a process or worker at once
_BATCHES_EACH = 16  # for each process at least, so that little is lost when a study ends early


def study(
    context: typer.Context,
    config: Annotated[Path | None, typer.Argument(help="Configuration (TOML) of aircraft and mission.")] = None,
    targets: Annotated[list[Path] | None, _TARGETS(help="Folder of recorded targets (.csv, .gpx).")] = None,
    routes: Annotated[bool, _TARGETS(help="Plan with the route next to each track, NAME.route.csv.")] = False,
    runs: Annotated[int | None, _TARGETS(min=1, help="Number of targets [20, or all recorded].")] = None,
    run: Annotated[list[int] | None, _TARGETS(min=0, help="Fly only the run of this number (repeatable).")] = None,
    seed: Annotated[int, _TARGETS(min=0, help="Seed of all targets and noise.")] = 1,
    planner: Annotated[list[str] | None, _COMPARISON(help="Compare only this planner (repeatable).")] = None,
    controller: Annotated[str | None, _COMPARISON(help="Command of your own controller.")] = None,
    benchmark: Annotated[bool, _COMPARISON("--benchmark", help="Fly the fixed benchmark.")] = False,
    airspeed: AirspeedOption = None,
    radius: RadiusOption = None,
    target_speed: TargetSpeedOption = None,
    autopilot: Annotated[str, AIRCRAFT(help="The simulated autopilot that flies: arduplane or px4.")] = "arduplane",
    sweep: Annotated[list[str] | None, _COMPARISON(help="KEY=V1,V2 or KEY=FROM:TO:STEP (repeatable).")] = None,
    duration: Annotated[float | None, _TARGETS(min=10.0, max=86400.0, help="Longest run, s [1200].")] = None,
    fleet: Annotated[int, AIRCRAFT(min=1, max=6, help="Number of aircraft on each target.")] = 1,
    terrain: Annotated[Path | None, AIRCRAFT(help="Compare with and without this elevation data.")] = None,
    set_: SetOption = None,
    jobs: Annotated[int | None, _COMPUTATION(min=1, help="Processes; by default one for each core.")] = None,
    scheduler: Annotated[str | None, _COMPUTATION(help="Address of a Dask scheduler: tcp://HOST:PORT.")] = None,
    store: Annotated[Path | None, _COMPUTATION(help="Keep results in this SQLite file for the next time.")] = None,
    export: Annotated[Path | None, OUTPUT(help="Write a row for each run to this .csv file.")] = None,
    report: Annotated[Path | None, OUTPUT(help="Write a page with all figures to this .html file.")] = None,
    json: JsonOption = None,
) -> None:
    """Compare planners against many targets, random or recorded, in a closed loop with a simulated vehicle.

    Band 100 to 500 m, left side; noisy laser and gimbal. The whole program flies: input checks, filter, planner and
    mission exchange. lvfg, park and orbit are guidance laws of the literature, which steer an aircraft directly. The
    side is that of the course that the target made good over requirement.course_horizon_s, once it has moved 10 m.
    Recorded tracks are smoothed over 2.5 s. --target-speed is half the airspeed unless it is given; recorded targets
    whose 95th percentile is above it are skipped.

    On many machines: dask scheduler; dask worker tcp://HOST:8786 --nthreads 1 --nworkers -1 (on each).

    For example:
      sidelong study --runs 50 --planner predictive --planner paper --report study.html
      sidelong study --targets tracks --airspeed 12 --radius 40 --target-speed 5
      sidelong study --targets tracks --routes --planner predictive
      sidelong study --sweep aircraft.airspeed_m_s=12,15,18 --store sweep.db --report sweep.html
      sidelong study --autopilot px4 --set simulation.wind_speed_m_s=4 --set study.noise_draws=3
      sidelong study --fleet 2 --runs 50
      sidelong study --terrain dem --set simulation.home=[36.59,-84.24] --runs 50
      sidelong study --benchmark --json benchmark.json
      sidelong study --benchmark --planner controller --controller "python examples/controller.py"
      sidelong study --runs 10000 --scheduler tcp://HOST:8786 --store study.db
    """
    checked_output(json)
    given = _given(context)
    _check_options(given, fleet)
    if benchmark:
        _benchmark(Benchmark(targets, planner, controller or "", runs), jobs, json)
        return
    values, home_deg = _values(config, set_, airspeed, radius, target_speed)
    own = _own_values(values, targets is not None)
    sweeps = [parsed_sweep(words) for words in sweep or ()]
    if "aircraft.airspeed_m_s" not in dict(sweeps):
        _check_speeds(values.get("aircraft", {}).get("airspeed_m_s", 10.0), target_speed)
    base = StudySettings(
        planners=tuple(dict.fromkeys(planner or (*MISSION_PLANNERS, *((CONTROLLER,) if controller else ())))),
        runs=20 if runs is None else runs,
        seed=seed,
        duration_s=1200.0 if duration is None else duration,
        autopilot=autopilot,
        controller=controller or "",
        **own,
    )
    if terrain is not None:
        base = replace(base, planners=(PREDICTIVE,), hills=_hills(terrain, home_deg))
        if "study.terrain" not in dict(sweeps):
            sweeps.append(parsed_sweep("study.terrain=known,ignored"))
    found = designs(base, values, sweeps, console.print)
    if terrain is not None or fleet > 1:
        _check_side("--fleet" if terrain is None else "--terrain", found)
    found = _recorded(found, targets, runs, math.inf if duration is None else duration, routes)
    found = _only(found, run)
    workers = on_processes(jobs) if scheduler is None else on_cluster(scheduler, console.print)
    if fleet > 1:
        _fly_fleet(found[0].settings, fleet, workers, json)
        return
    with contextlib.closing(ResultStore(store)) as kept:
        whole = Study(found, kept)
        _fly(whole, workers, 1 if scheduler is not None else _BATCHES_EACH * (jobs or os.cpu_count() or 1))
        results = whole.results()
    _announce(results, json)
    if export is not None:
        with writing(export, "--export"):
            export_runs(results, export)
    if report is not None:
        again = ["sidelong", "study", *(word for name, own in given.items() if name not in _OF_WHOLE for word in own)]
        words = ["sidelong", "study", *(word for own in given.values() for word in own)]
        with writing(report, "--report"):
            write_page(results, shlex.join(words), shlex.join(again), report)


def _given(context: typer.Context) -> dict[str, list[str]]:
    """Return the words of each argument and option that was given, by its name."""
    found: dict[str, list[str]] = {}
    for option in context.command.params:
        value, name = context.params.get(option.name or ""), option.opts[0]
        if option.name is None or getattr(context.get_parameter_source(option.name), "name", "") != "COMMANDLINE":
            continue
        words = [name] if name.startswith("--") else []
        values = value if isinstance(value, list | tuple) else [value]
        found[option.name] = words if value is True else [word for of in values for word in (*words, str(of))]
    return found


def _hills(terrain: Path, home_deg: tuple[float, float] | None) -> StudyTerrain:
    if home_deg is None:
        raise InputError("--terrain needs a place within the elevation data; give --set simulation.home=[LAT,LON].")
    from sidelong.app.study.closed_loop import hills_of  # noqa: PLC0415  # compiled code takes a second to load

    return hills_of(elevation_data(terrain).ground(LocalPlane(*home_deg), home_deg))


def _fly_fleet(settings: StudySettings, aircraft: int, workers: Workers, json: Path | None) -> None:
    together = with_values(settings.config, {"requirement": {"fleet_size": aircraft}}, "--fleet")
    settings = replace(settings, config=together)
    with runs_progress(len(FleetPlannerName) * len(settings.numbers)) as advance:
        flown = fly_fleets(settings, table_of(settings), workers, advance)
    for name, reason in settings.skipped:
        console.print(f"skipped {name}: {reason}")
    if str(json) != "-":
        console.print(f"{aircraft} aircraft on each target, {settings.layer_m:g} m of height apart")
        console.print(study_parts(settings))
        print_whole(fleet_table(flown))
    write_json(json, fleet_json(settings, flown))


def _benchmark(benchmark: Benchmark, jobs: int | None, json: Path | None) -> None:
    if not is_compiled(PREDICTIVE):
        console.print("compiling the flights, once for this version of the program: up to a minute")
    with runs_progress(benchmark.total) as advance:
        rows = benchmark.fly(jobs, advance)
    if str(json) != "-":
        print_whole(benchmark_table(rows))
        console.print(f"mean / worst run; {benchmark.total} runs in {benchmark.wall_s / 60.0:.1f} min")
    write_json(json, benchmark.json(rows))


def _fly(study: Study, workers: Workers, batches: int) -> None:
    missing = study.missing()
    if missing < study.total:
        console.print(f"{study.total - missing} of {study.total} runs are in {study.store.file} already")
    if not missing:
        return
    if not is_compiled(*study.designs[0].settings.planners):
        console.print("compiling the flights, once for this version of the program: up to a minute")
    with runs_progress(missing) as advance:
        try:
            size = min(max(missing // batches, 1), _BATCH_MAX)
            study.fly(workers, table_of, size, advance)
        except KeyboardInterrupt:
            if study.store.file is not None:
                done = study.total - study.missing()
                console.print(
                    f"interrupted: {done} of {study.total} runs are in {study.store.file}; "
                    "the same command goes on from there"
                )
            raise


def _announce(results: list[StudyResult], json: Path | None) -> None:
    first = results[0]
    for name, reason in first.settings.skipped:
        console.print(f"skipped {name}: {reason}")
    if str(json) != "-":
        console.print(study_title(first))
        console.print(study_parts(first.settings))
        print_whole(sweep_table(results) if len(results) > 1 else study_table(first))
        if len(results) > 1:
            console.print(EXPLAINED)
    write_json(json, study_json(results))


def _recorded(
    found: tuple[Design, ...], targets: list[Path] | None, runs: int | None, duration_s: float, routes: bool
) -> tuple[Design, ...]:
    if targets is None:
        return found
    slowest_m_s = min(design.settings.requirement().target_speed_max_m_s for design in found)
    read = recorded_targets(targets, slowest_m_s, *((route_next_to,) if routes else ()))
    for note in read.notes:
        console.print(f"note: {note}")
    if routes and not any(track.route for track in read.flown):
        raise InputError("--routes: no track has a route next to it; put NAME.route.csv (east_m,north_m) there.")
    tracks = read.flown[:runs]
    of_targets: dict[str, Any] = {
        "tracks": tracks,
        "runs": len(tracks),
        "skipped": read.skipped,
        "duration_s": duration_s,
    }
    return tuple(replace(design, settings=replace(design.settings, **of_targets)) for design in found)


def _only(found: tuple[Design, ...], numbers: list[int] | None) -> tuple[Design, ...]:
    if not numbers:
        return found
    last = len(found[0].settings.numbers) - 1
    if max(numbers) > last:
        raise InputError(f"--run: there is no run {max(numbers)}; they are 0 to {last}.")
    only = tuple(dict.fromkeys(numbers))
    return tuple(replace(design, settings=replace(design.settings, only=only)) for design in found)


def _values(
    config: Path | None,
    given: list[str] | None,
    airspeed_m_s: float | None,
    radius_m: float | str | None,
    target_speed_m_s: float | None,
) -> tuple[Overrides, tuple[float, float] | None]:
    """Return what shapes the study, by section and key, and the home position, latitude and longitude in degrees."""
    known = SHAPING | {"study": (*_OWN_KEYS, "lag_s"), "simulation": (*SHAPING["simulation"], "home")}
    changes = changed_keys(given)
    for section, keys in changes.items():
        for key in keys:
            if key not in known.get(section, ()):
                of_section = f"{section}.{', '.join(known[section])}" if section in known else ", ".join(known)
                raise InputError(f"--set {section}.{key} shapes no study; known: {of_section}.")
    mission = load_config(config)
    home = changes.get("simulation", {}).pop("home", None)
    of_options: Overrides = {
        "aircraft": {"airspeed_m_s": airspeed_m_s, "radius_m": radius_m},
        "requirement": {"target_speed_max_m_s": target_speed_m_s},
    }
    values = changed_keys(None, {} if config is None else configured(mission), of_options, changes)
    return values, with_values(mission, {"simulation": {"home": home}}, "--set").simulation.home


def _check_speeds(airspeed_m_s: float, target_speed_max_m_s: float | None) -> None:
    least, greatest = _AIRSPEED_M_S
    if not least <= airspeed_m_s <= greatest:
        raise InputError(f"--airspeed: {airspeed_m_s:g} m/s is not from {least:g} to {greatest:g} m/s.")
    if target_speed_max_m_s is not None and not 0.0 <= target_speed_max_m_s < airspeed_m_s:
        raise InputError(
            f"--target-speed: {target_speed_max_m_s:g} m/s is not from 0 to below the airspeed, {airspeed_m_s:g}."
        )


def _own_values(values: Overrides, is_recorded: bool) -> dict[str, Any]:
    own: dict[str, Any] = {key: values["study"].pop(key) for key in _OWN_KEYS if key in values.get("study", {})}
    for key, value in own.items():
        try:
            own[key] = _OWN_KEYS[key].validate_python(value)
        except ValidationError as error:
            raise InputError(f"study.{key}: {error.errors()[0]['msg']}, not {value!r}.") from error
    if is_recorded and "legs_s" in own:
        raise InputError("study.legs_s: recorded targets move as recorded; leave it out.")
    if "legs_s" in own and own["legs_s"][0] > own["legs_s"][1]:
        raise InputError(f"study.legs_s: {list(own['legs_s'])} is no [LEAST, GREATEST] in seconds.")
    return own


def _check_options(given: dict[str, list[str]], fleet: int) -> None:
    """Raise InputError for an option that is wrong, has no effect, or names a file that cannot be written."""
    autopilot, scheduler = (given.get(name, [""])[-1] for name in ("autopilot", "scheduler"))
    planners, known = given.get("planner", [])[1::2], (*MISSION_PLANNERS, *LAWS, CONTROLLER)
    unknown = ", ".join(sorted({*planners} - {*known}))
    not_in_benchmark = next((words[0] for name, words in given.items() if name not in _OF_BENCHMARK), "")
    placed = "terrain" not in given and any(word.startswith("simulation.home=") for word in given.get("set_", ()))
    own_alone = CONTROLLER in planners and "controller" not in given
    wrong = (
        ("planner", unknown, f"there is no {unknown!r}; known: {', '.join(known)}"),
        ("planner", own_alone, "controller flies your own program; give its command by --controller"),
        ("store", "controller" in given, "a program may change, so nothing is stored; leave out --controller"),
        ("benchmark", not_in_benchmark, f"fixes targets, aircraft and noise; leave out {not_in_benchmark}"),
        ("autopilot", autopilot not in LAG_S, f"there is no simulated {autopilot!r}; give {' or '.join(LAG_S)}"),
        ("routes", "targets" not in given, "routes are read next to recorded tracks; give --targets DIR"),
        ("set_", placed, "simulation.home places the study on elevation data; give --terrain with it"),
        ("terrain", fleet > 1, "flies one aircraft; leave out --fleet"),
        ("terrain", {*planners} - {PREDICTIVE}, "flies the default planner; leave out other planners"),
        ("planner", fleet > 1, f"--fleet compares those of fleets, {', '.join(FleetPlannerName)}; leave it out"),
        ("sweep", fleet > 1, "--fleet flies one design; leave it out"),
        ("jobs", "scheduler" in given, "the workers of --scheduler compute; leave it out"),
        ("scheduler", not _SCHEDULER.fullmatch(scheduler), f"{scheduler!r} is no address such as tcp://HOST:8786"),
        *((file, fleet > 1, "--fleet prints a table; give --json instead") for file in ("export", "report", "store")),
    )
    for name, applies, words in wrong:
        if applies and name in given:
            raise InputError(f"{given[name][0]}: {words}.")
    for name, suffix in (("export", ".csv"), ("report", ".html"), ("store", "")):
        if name in given:
            option, file = given[name]
            if not file.lower().endswith(suffix):
                raise InputError(f"{file}: {option} writes {suffix}; give it such a file name.")
            checked_file(option, Path(file))


def _check_side(option: str, found: tuple[Design, ...]) -> None:
    wanted = [one.settings.requirement() for one in found]
    if any(one.either_side or one.sector is not None for one in wanted):
        raise InputError(f"{option} watches from one side; set requirement.side to left or right.")
    if option == "--fleet" and any(one.settings.aircraft().has_pan_limit for one in found):
        raise InputError("aircraft.pan_limit_deg: a fleet plans for no pan limits; leave it out.")

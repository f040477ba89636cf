"""``sidelong launch``: fly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from sidelong.app.commands.options import (
    MAP,
    OUTPUT,
    AirspeedOption,
    ConfigArgument,
    Overrides,
    PlannerOption,
    RadiusOption,
    SetOption,
    TargetSpeedOption,
    TerrainOption,
    changed_keys,
    panel,
)
from sidelong.app.commands.output import (
    JsonOption,
    checked_output,
    console,
    print_notes,
    say,
    shielded_output,
    standard,
    warn,
    write_json,
)
from sidelong.app.commands.report import write_report
from sidelong.app.config import (
    DEMONSTRATION,
    MAX_AIRCRAFT,
    Config,
    load_config,
    reach_warning,
    room_warning,
    setting_notes,
    with_values,
)
from sidelong.app.config_files import check_files, check_single
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import FleetFile, load_fleet, names_a_fleet
from sidelong.app.flight.outputs import check_hosts
from sidelong.app.link.transport import checked_url
from sidelong.app.payload.registry import KIND_NAMES, MAVLINK, read_payload
from sidelong.app.process import heed_interrupts, program
from sidelong.app.records.run_folder import check_space
from sidelong.app.view.address import PageAddress, free_port, is_desktop, page_address

if TYPE_CHECKING:
    from sidelong.app.flight.shell import FlightEnded

_MISSION = panel("Mission")
_VEHICLE = panel("Vehicle and link")
_PAYLOAD = panel("Payload")
_SIMULATION = panel("Simulation")

_DURATION_S = 1200.0
_VIDEO, _RENDERED_VIEW_DEG = ("video", "rtsp", "rtsps", "udp"), 12.0
_DRIVER_SPEED_MAX = 4.0  # a simulated payload's data are stamped as they arrive: faster, this computer's load shows


def launch(
    config: ConfigArgument = None,
    fleet: Annotated[int | None, _MISSION(min=1, max=MAX_AIRCRAFT, help="Number of aircraft for one target.")] = None,
    connect: Annotated[list[str] | None, _VEHICLE(help="MAVSDK URL of a vehicle; twice for two links.")] = None,
    payload: Annotated[
        str | None,
        _PAYLOAD(
            metavar="KIND://HOST[:PORT]",
            help=f"{', '.join(KIND_NAMES)}; a camera's video: rtsp://, udp://; simulated: KIND://, video://.",
        ),
    ] = None,
    route: Annotated[
        str | None,
        _MISSION(
            metavar="FILE|mavlink:ID",
            help="Expected route of the target: a file, or the mission of MAVLink system ID, which is the target.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        _SIMULATION(
            metavar="MOTION|FILE[#NAME]", help="Simulated target: a motion, or a track (.gpx, .csv, .kml, .geojson)."
        ),
    ] = None,
    target_speed: TargetSpeedOption = None,
    airspeed: AirspeedOption = None,
    radius: RadiusOption = None,
    duration: Annotated[float, _MISSION(min=1.0, max=1e6, help="Watch this long, s.")] = _DURATION_S,
    seed: Annotated[int | None, _SIMULATION(help="Seed of the simulation's noise.")] = None,
    side: Annotated[str | None, _MISSION(help="Watch from left, right, either or bearings (120-200).")] = None,
    autopilot: Annotated[str | None, _SIMULATION(help="arduplane or px4; of a fleet in turn: a,b.")] = None,
    planner: PlannerOption = None,
    view: Annotated[bool | None, MAP("--view/--no-view", help="Live map in the browser [on a desktop].")] = None,
    report: Annotated[bool, OUTPUT("--report", help="Write report.html into the run folder.")] = False,
    mcap: Annotated[bool, OUTPUT("--mcap", help="Also write flight.mcap, for Foxglove and PlotJuggler.")] = False,
    terrain: TerrainOption = None,
    set_: SetOption = None,
    out: Annotated[Path, OUTPUT(help="Where run folders are made.")] = Path("runs"),
    quiet: Annotated[bool, OUTPUT("--quiet", help="Print the summary only.")] = False,
    json: JsonOption = None,
) -> None:
    """Fly: circle to one side of the target and relocate the circle as the target moves.

    Without --connect, this command starts a simulated vehicle and target. They run ten times faster than real time,
    or as --set simulation.speed has it.

    For example:
      sidelong launch
      sidelong launch --autopilot px4 --target walk --side right --view
      sidelong launch mission.toml --connect udpin://0.0.0.0:14540
      sidelong launch --connect udpin://0.0.0.0:14540 --payload siyi://192.168.144.25
      sidelong launch --payload video://
      sidelong launch --connect udpin://0.0.0.0:14540 --route ferry.gpx
      sidelong launch --fleet 2 --autopilot arduplane,px4
      sidelong launch mission.toml --set link.system_id=2 --set sharing.cot=udp://127.0.0.1:6969
    """
    checked_output(json)
    video, payload_kind, payload_url = _payload_keys(payload)
    of_vehicle = route is not None and route.startswith("mavlink:")
    overrides: Overrides = {
        "camera": {"source": video},
        "payload": {"kind": payload_kind, "url": payload_url},
        "link": {"urls": connect or None},
        "aircraft": {"airspeed_m_s": airspeed, "radius_m": radius},
        "simulation": {"target": target or (None if config or connect else DEMONSTRATION)}
        | {"seed": seed, "autopilot": autopilot},
        "requirement": {"side": side, "target_speed_max_m_s": target_speed},
        "terrain": {"folder": None if terrain is None else str(terrain)},
        "planner": {"name": planner},
        "route": {"system_id" if of_vehicle else "file": route.removeprefix("mavlink:") if route else None},
    }
    overrides = changed_keys(set_, overrides)
    if mcap:
        from sidelong.app.records.mcap import mcap_writer_class  # noqa: PLC0415  # it loads the filter

        mcap_writer_class()
    silent = quiet or str(json) == "-"
    if fleet is not None or names_a_fleet(config):
        several = load_fleet(config, overrides, fleet)
        flown: Config = several if len(several.aircraft) > 1 else several.members[0].config
    else:
        flown = load_config(config, overrides)
    with shielded_output():  # from the first line that is printed
        address = _map_address(view, silent, flown)
        _check_simulated(flown, {"--target": target, "--seed": seed, "--autopilot": autopilot})
        flown = _checked(flown, overrides["simulation"].get("speed"), payload_url)
        check_space(out, duration, len(flown.aircraft) if isinstance(flown, FleetFile) else 1, warn)
        # The flight modules take a second to load; report a wrong option first.
        from sidelong.app.commands.flying import fly_recorded  # noqa: PLC0415

        ended = fly_recorded(flown, duration, out, quiet, address)
        _announce(ended, json)
        if ended.reason is not None:
            raise ended.reason
        heed_interrupts()
        if mcap:
            from sidelong.app.commands.export import write_export  # noqa: PLC0415  # as above
            from sidelong.app.records.export import Format  # noqa: PLC0415

            write_export(ended.folder.path, Format.MCAP)
        if report:
            write_report(ended.folder.path, ended.folder.path / "report.html")


def _checked(flown: Config, speed: float | None, payload_url: str | None) -> Config:
    if isinstance(flown, FleetFile):
        print_notes(check_files(flown, flown.target))
        for member in flown.members:
            _check_input(member.config)
        if flown.link.system_id is not None:
            raise InputError("link.system_id names one vehicle; give each aircraft of the fleet file its system_id.")
        print_notes(setting_notes(flown))
        return flown
    flown = _with_simulated_camera(_with_simulated_payload(flown, speed, payload_url))
    print_notes(check_single(flown))
    _check_input(flown)
    print_notes((room_warning(flown), reach_warning(flown), *setting_notes(flown)))
    return flown


def _map_address(view: bool | None, silent: bool, settings: Config) -> PageAddress | None:
    """Return the address of the map; view None: in a desktop session, on another port if that one is in use."""
    unasked = view is None and is_desktop() and not silent
    if view is None and not (unasked or silent):
        say("--view shows the live map; without a desktop it prints the address")
    port = free_port(settings.display.port) if unasked else None
    address = page_address(unasked or bool(view), settings.display, port)
    return address and replace(address, opens_browser=unasked and address.is_local)


def _payload_keys(payload: str | None) -> tuple[str | None, str | None, str | None]:
    if payload is None or payload.partition("://")[0] in _VIDEO:
        return payload, None, None
    return None, *read_payload("--payload", payload)


def _with_simulated_camera(settings: Config) -> Config:
    if settings.camera.source is None or not settings.is_simulated:
        return settings
    changed: dict[str, Any] = {"simulation": {"speed": 1.0}}  # pictures are made in real time
    if not settings.terrain.is_known:
        changed["terrain"] = {"flat": True}
    if "view_deg" not in settings.camera.model_fields_set:
        changed["camera"] = {"view_deg": _RENDERED_VIEW_DEG}
    return with_values(settings, changed, "camera.source")


def _with_simulated_payload(settings: Config, speed: float | None, url: str | None) -> Config:
    """Slow the simulation down for a payload with a driver, unless a speed is given."""
    kind = settings.payload.kind
    if kind == MAVLINK or settings.link.connections:
        return settings
    if url is not None:
        raise InputError(f"--payload {url}: a simulated vehicle has a simulated payload; give {kind}:// alone.")
    if speed is None:
        slower = {"speed": min(settings.simulation.speed, _DRIVER_SPEED_MAX)}
        return with_values(settings, {"simulation": slower}, "command line")
    if speed > _DRIVER_SPEED_MAX:
        warn(f"simulation.speed = {speed:g}: above {_DRIVER_SPEED_MAX:g}, readings by {kind} get wrong times.")
    return settings


def _check_input(settings: Config) -> None:
    check_hosts(settings.sharing)
    for url in settings.link.connections:
        checked_url(url)
    if settings.payload.point_gimbal and settings.terrain.is_known and settings.sensors.angles_alone:
        raise InputError(
            "payload.point_gimbal points the gimbal at the estimate, which would confirm itself while the laser is "
            "silent; set sensors.angles_alone = false with it."
        )


def _check_simulated(settings: Config, options: dict[str, object]) -> None:
    """Raise InputError for options of the simulation where a vehicle would fly. Its operator may expect none to."""
    given = [name for name, value in options.items() if value is not None]
    if given and not settings.is_simulated:
        raise InputError(
            f"{', '.join(given)}: for a simulated vehicle only, and this configuration has a link to a vehicle; "
            "leave the option out to fly that vehicle, or leave --connect and the configured link out to simulate."
        )


def _announce(ended: FlightEnded, json: Path | None) -> None:
    console.print(ended.summary.table())
    say(f"run folder: {ended.folder.path}")
    folder = quote(str(ended.folder.path))
    say(f"next: {program()} report {folder}, or {program()} replay {folder} --view")
    try:
        ended.folder.write_summary(ended.summary.as_json())
    except OSError as error:
        warn(f"{ended.folder.summary} cannot be written ({error.strerror}); the figures above are all there is.")
    try:
        write_json(json, ended.summary.as_json())
    except InputError as error:
        if ended.reason is None:
            raise
        warn(str(error))
    if standard.lost is not None:
        warn(f"the terminal could not be written ({standard.lost}); see {ended.folder.path}.")

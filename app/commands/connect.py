"""``sidelong connect``: check the vehicle at the other end of a link, and its readiness."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from sidelong.app.assembly import tracker_of
from sidelong.app.commands.options import Overrides, PayloadOption, SetOption, changed_keys
from sidelong.app.commands.output import JsonOption, checked_output, console, say, write_json
from sidelong.app.commands.payload import degrees_of, payload_lines, payload_values
from sidelong.app.config import Config, load_config
from sidelong.app.config_files import check_files, check_single
from sidelong.app.errors import FlightError, InputError
from sidelong.app.fleet.fleet_file import load_fleet, names_a_fleet
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.preflight import Check, SourceRates, checks, describe_use
from sidelong.app.flight.session import InputHealth, connected, with_fences
from sidelong.app.flight.streams import ask_for_streams
from sidelong.app.link.message import Message
from sidelong.app.link.stored import read_table
from sidelong.app.link.transport import checked_url
from sidelong.app.link.vehicle import home_of, mode_of, reported_pan_limits_rad, request_pan_limits
from sidelong.app.payload.registry import read_payload
from sidelong.app.payload.session import PayloadStatus, contradiction, pan_words
from sidelong.app.process import run
from sidelong.app.records.sensing import Sensing
from sidelong.mission.core.events import Event


def connect(
    urls: Annotated[list[str] | None, typer.Argument(help="MAVSDK URLs of the vehicle; else link.url.")] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML) to check against.")] = None,
    listen_s: Annotated[float, typer.Option("--listen", min=0.5, max=3600.0, help="Listen this long, s.")] = 3.0,
    payload: PayloadOption = None,
    set_: SetOption = None,
    json: JsonOption = None,
) -> None:
    """List the detected components (autopilot, mode, position, sensors, parameters) and failing pre-flight checks.

    This command arms and changes nothing. With a fleet file, it checks all aircraft, one after the other. The exit
    code is 0 if all is ready, 1 if a check fails, 2 if there is no vehicle.

    For example:
      sidelong connect udpin://0.0.0.0:14540
      sidelong connect serial:///dev/ttyUSB0:57600 --config mission.toml
      sidelong connect udpin://0.0.0.0:14540 --payload siyi://192.168.144.25
      sidelong connect udpin://0.0.0.0:14540 --set link.system_id=2
      sidelong connect --config fleet.toml
    """
    checked_output(json)
    payload_kind, payload_url = (None, None) if payload is None else read_payload("--payload", payload)
    of_options: Overrides = {"payload": {"kind": payload_kind, "url": payload_url}, "link": {"urls": urls or None}}
    overrides = changed_keys(set_, of_options)
    reports, missing = [], []
    if names_a_fleet(config):
        if urls or overrides["link"].get("system_id") is not None:
            raise InputError(f"{config} has the links of its aircraft; leave out the URL and link.system_id.")
        fleet = load_fleet(config, overrides)
        check_files(fleet, fleet.target)
        for member in fleet.members:
            console.print(f"{member.name}:")
            try:
                reports.append({"name": member.name, **run(_report(member.config, listen_s))})
            except InputError as error:
                missing.append(f"{member.name}: {error}")
                console.print(str(error))
        write_json(json, {"ready": not missing and all(report["ready"] for report in reports), "aircraft": reports})
    else:
        settings = load_config(config, overrides)
        for url in _links(settings):
            checked_url(url)
        check_single(settings)
        reports.append(run(_report(settings, listen_s)))
        write_json(json, reports[0])
    if missing:
        raise InputError(" ".join(missing))
    failing = [check["name"] for report in reports for check in report["checks"] if not check["ready"]]
    if failing:
        raise FlightError(f"not ready: {', '.join(dict.fromkeys(failing))}; see the lines above.")


def _links(settings: Config) -> list[str]:
    if not settings.link.connections:
        raise InputError("no vehicle is named; give its URL, or a --config with link.url.")
    return list(settings.link.connections)


def _payload_check(status: PayloadStatus) -> Check:
    ready = status.angles_hz > 0.0  # no range is asked for: on the ground, the laser may well meet nothing
    return Check("payload", ready, "its angles arrive" if ready else status.missing[0])


async def _report(config: Config, listen_s: float) -> dict[str, Any]:
    urls = _links(config)
    console.print(f"waiting for a heartbeat on {' and '.join(urls)}")
    async with (
        connected(config.link, console.print) as session,
        payload_input(config, session.vehicle, console.print) as payload,
    ):
        vehicle, autopilot = session.vehicle, session.autopilot
        await ask_for_streams(vehicle)
        sources, inputs, tracker = SourceRates(vehicle), InputHealth(config, session.inputs), tracker_of(config)
        sensing = Sensing(tracker)

        def estimate_delays(_message: Message, event: Event | None, _admitted: Event | None) -> None:
            if event is not None:
                sensing.take(event)

        session.inputs.listeners.append(estimate_delays)
        rates = await sources.received(listen_s, config.sharing)
        inputs.close()
        sources.close()
        session.inputs.listeners.remove(estimate_delays)
        home = await home_of(vehicle)
        await request_pan_limits(vehicle)
        pan_rad = reported_pan_limits_rad(vehicle)
        parameters = await read_table(vehicle, autopilot, session.release)
        values, notes = parameters.values, parameters.notes()
        required = parameters.as_on_board(autopilot.required_parameters(values, config.aircraft.airspeed_m_s))
        status = None if payload is None else payload.status()
        try:
            fences = Check("fences", True, str((await with_fences(vehicle, config, parameters))[1]))
        except InputError as error:
            fences = Check("fences", False, str(error))
        one = Check("one vehicle", session.senders.two_vehicles is None, session.senders.two_vehicles or "yes")
        flyable = checks(config, vehicle, autopilot, parameters, home, rates, required)
        found = [one, fences, *flyable, *inputs.checks()]
        found += [] if status is None else [_payload_check(status)]
        firmware = f"{autopilot.name} {session.release or ''}".strip()
        console.print(f"{firmware}, system {vehicle.system_id}, mode {mode_of(vehicle)}")
        table = Table("requirement", "", "found", box=None, pad_edge=False)
        for check in found:
            table.add_row(check.name, "ready" if check.ready else "NOT READY", check.words)
        console.print(table)
        listed = Table("parameter", "value", "", box=None, pad_edge=False)
        for note in notes:
            listed.add_row(note.name, "-" if note.value is None else f"{note.value:g}", note.note)
        console.print(listed)
        uses: dict[str, str] = {}
        for kind in dict.fromkeys(rate.kind for rate in rates):
            of_kind = [rate for rate in rates if rate.kind == kind]
            described = describe_use(config, kind, [rate.source for rate in of_kind])
            for rate in of_kind:
                uses[str(rate)] = "not used: it holds no reading" if rate.fault else described[rate.source]
                say(f"{kind}: {rate}: {uses[str(rate)]}")
        for line in () if status is None else payload_lines(config.payload.kind, status):
            say(line)
        for words in filter(None, (*pan_words(pan_rad), contradiction(config.aircraft.pan_limit_deg, pan_rad))):
            say(words)
        delays, taken = tracker.delays, "gimbal {:g} s, laser {:g} s as configured".format(*tracker.latencies_s)
        unknown = f"{taken}; estimated in flight, here only with --listen 300"  # it takes minutes of circling
        say(f"delays of the payload's stamps: {delays or unknown}")
        return {
            "autopilot": autopilot.name,
            "release": None if session.release is None else str(session.release),
            "commit": None if session.release is None else session.release.commit,
            "system_id": vehicle.system_id,
            "mode": mode_of(vehicle),
            "ready": all(check.ready for check in found),
            "checks": [asdict(check) for check in found],
            "parameters": {note.name: note.value for note in notes},
            "limits": asdict(autopilot.limits(values)),
            "payload": None if status is None else payload_values(status),
            "pan_limits_deg": degrees_of(pan_rad),
            "delays": None if delays is None else asdict(delays),
            "sources": [{**asdict(rate), "use": uses[str(rate)]} for rate in rates],
        }

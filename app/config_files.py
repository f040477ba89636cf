"""The files and modes that a configuration names and its fences, checked before any connection or computation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from sidelong.app.config import SIMULATED_VIDEO, Config, RouteSection, check_alone, check_flyable
from sidelong.app.errors import InputError, missing_package
from sidelong.app.link.transport import checked_form
from sidelong.app.records.route_file import read_flight_route
from sidelong.app.terrain.elevation_data import elevation_data


class NamedTarget(Protocol):
    """A target of a fleet."""

    name: str
    route: RouteSection | None
    motion: str | None


def check_single(config: Config) -> list[str]:
    """Return notes on the files; raise InputError where one aircraft cannot fly this configuration."""
    check_alone(config)
    check_flyable(config)
    return check_files(config)


def check_files(config: Config, targets: Sequence[NamedTarget] = ()) -> list[str]:
    """Return what of the tracks and routes is not used, in words.

    Raises InputError, which names the field, if a file or mode cannot be used or a fence is no polygon.
    """
    notes = []
    for field, check in _checks(config, targets):
        try:
            note = getattr(check(), "note", "")
            notes += [f"{field}: {note}"] if note else []
        except InputError as error:
            raise InputError(f"{field}: {error}") from error
    if config.fences.keep_in or config.fences.keep_out:
        from sidelong.app.assembly import check_room  # noqa: PLC0415  # it loads the filter

        check_room(config)
    if config.sharing.cot is not None:
        from sidelong.app.flight.outputs import tls_of  # noqa: PLC0415  # it loads MAVLink

        tls_of(config.sharing)
    return notes


def _checks(config: Config, targets: Sequence[NamedTarget]) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield each field that names a file or a flight mode, with its check."""
    for url in config.link.connections:
        yield "link.url", partial(checked_form, url)
    if config.link.take_over_from:
        yield "link.take_over_from", partial(_check_modes, config.link.take_over_from)
    if config.link.signing_key_file is not None:
        from sidelong.app.link.signing import read_key  # noqa: PLC0415  # as above

        yield "link.signing_key_file", partial(read_key, config.link.signing_key_file)
    if config.camera.source is not None:
        yield "camera.source", partial(_check_camera, config, config.camera.source)
    if config.terrain.folder is not None:
        yield "terrain.folder", partial(elevation_data, Path(config.terrain.folder))
    routes_of_targets = ((f"target {target.name!r}: route", target.route) for target in targets)
    for field, route in (("route", config.route), *routes_of_targets):
        if route is not None and route.file is not None:
            yield f"{field}.file", partial(read_flight_route, route.file)
    if config.is_simulated:
        if isinstance(config.simulation.autopilot, str):  # a fleet has several
            yield "planner.guidance", partial(_check_guidance, config.simulation.autopilot, config.planner.guidance)
        yield "simulation.target", partial(_check_motion, config.simulation.target)
        for target in targets:
            if target.motion is not None:
                yield f"target {target.name!r}: motion", partial(_check_motion, target.motion)


def _check_camera(config: Config, source: str) -> None:
    try:
        from sidelong.app.camera.video import checked_source  # noqa: PLC0415  # an extra
    except ImportError as error:
        raise missing_package("it", "av opencv-contrib-python-headless") from error
    if config.payload.point_gimbal:
        raise InputError("it leads the gimbal itself; leave payload.point_gimbal out.")
    if config.is_simulated and source != SIMULATED_VIDEO:
        raise InputError(f"a simulated vehicle has a simulated camera; give {SIMULATED_VIDEO} alone.")
    if not config.is_simulated:
        if source == SIMULATED_VIDEO:
            raise InputError(f"{SIMULATED_VIDEO!r} is for a simulated vehicle; name the video.")
        checked_source(source)


def _check_guidance(key: str, guidance: str) -> None:
    from sidelong.app.autopilots.registry import AUTOPILOTS, check_guidance  # noqa: PLC0415  # as above

    check_guidance(next(one for one in AUTOPILOTS if one.key == key), guidance)


def _check_modes(modes: Sequence[str]) -> None:
    from sidelong.app.link.telemetry import FAILSAFE, RECOVERY_MODES  # noqa: PLC0415  # as above

    known = (*RECOVERY_MODES, FAILSAFE)
    for mode in modes:
        if mode.upper() not in map(str.upper, known):
            raise InputError(
                f"{mode!r:.40} needs no permission or does not exist; those that need one are {', '.join(known)}."
            )


def _check_motion(motion: str) -> object:
    from sidelong.sitl.world.motion import MOTIONS  # noqa: PLC0415  # only a simulated flight needs them
    from sidelong.sitl.world.track import read_track  # noqa: PLC0415
    from sidelong.sitl.world.track_file import TrackError, is_track_file  # noqa: PLC0415

    if motion in MOTIONS:
        return None
    if not is_track_file(Path(motion)):
        raise InputError(f"{motion!r} is none of {', '.join(MOTIONS)} or a track such as a .gpx or .csv file.")
    try:
        return read_track(Path(motion))
    except TrackError as error:
        raise InputError(f"{error}; give another track or one of {', '.join(MOTIONS)}.") from error

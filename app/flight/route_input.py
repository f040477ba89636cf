"""Reads the target's route for a flight: from a file, or from the target itself, whose mission it is."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

import numpy as np

from sidelong.app.config import RouteSection
from sidelong.app.errors import InputError
from sidelong.app.flight.session import Session
from sidelong.app.link.other_mission import read_mission
from sidelong.app.link.vehicle import LinkError
from sidelong.app.records.route_file import read_flight_route
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import RouteGiven

_FAR_M = 20_000.0  # from the origin of the plane: farther routes are probably wrong coordinates


def check_route(route: RouteSection, own_ids: Collection[int]) -> None:
    """Raise InputError if the route is to be read from an aircraft of the flight itself, by its system id."""
    if route.system_id in own_ids:
        raise InputError(f"system {route.system_id} is the aircraft itself: give the system id of the target.")


def give_route(
    route: RouteSection,
    session: Session,
    plane: LocalPlane,
    put: Callable[[RouteGiven], object],
    note: Callable[[str], object],
) -> None:
    """Pass on the configured route, as an event of the vehicle's time; the target's mission once it is read.

    Args:
        route: The configuration.
        session: The connected vehicle, whose links the target's mission is read on.
        plane: The local plane of the flight.
        put: Receives the route.
        note: Receives in words why there is none, or that it is far away.

    Raises:
        InputError: The route file cannot be used.
    """

    def pass_on(east_m: Iterable[float], north_m: Iterable[float], lap: bool) -> None:
        way = tuple(east_m), tuple(north_m)
        put(RouteGiven(session.telemetry.now_s, *way, lap, route.tolerance_m, route.speed_m_s, route.direction))
        nearest_m = float(np.hypot(*way).min())
        if nearest_m > _FAR_M:
            note(
                f"the nearest way point of the route is more than {nearest_m // 1000:.0f} km away: check the route, "
                "the order of latitude and longitude, and that they are degrees"
            )

    async def of_mission(system_id: int) -> None:
        try:
            mission = await read_mission(session.vehicle, system_id)
        except (LookupError, LinkError) as error:
            note(f"no route: {error}; the flight continues without it")
            return
        east_m, north_m = zip(*(plane.east_north_m(*point) for point in mission.points_deg), strict=True)
        pass_on(east_m, north_m, route.lap or mission.lap)

    if route.file is not None:
        east_m, north_m = read_flight_route(route.file).in_plane(plane)
        pass_on(east_m.tolist(), north_m.tolist(), route.lap)
    if route.system_id is not None:
        session.begin(of_mission(route.system_id))

"""Reads the target's route for a flight: from a file, or from the target itself, whose mission it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from sidelong.app.config import RouteSection
from sidelong.app.flight.session import Session
from sidelong.app.link.link import LinkError
from sidelong.app.link.other_mission import read_mission
from sidelong.app.route_file import read_route
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import RouteGiven


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
        note: Receives in words why there is none.

    Raises:
        InputError: The route file cannot be read.
    """

    def event(east_m: Iterable[float], north_m: Iterable[float], lap: bool) -> RouteGiven:
        way = tuple(east_m), tuple(north_m)
        return RouteGiven(session.telemetry.now_s, *way, lap, route.tolerance_m, route.speed_m_s, route.direction)

    async def of_mission(system_id: int) -> None:
        try:
            mission = await read_mission(session.vehicle, system_id)
        except (LookupError, LinkError) as error:
            note(f"no route: {error}; the flight continues without it")
            return
        east_m, north_m = zip(*(plane.east_north_m(*point) for point in mission.points_deg), strict=True)
        put(event(east_m, north_m, route.lap or mission.lap))

    if route.file is not None:
        east_m, north_m = read_route(route.file).in_plane(plane)
        put(event(east_m.tolist(), north_m.tolist(), route.lap))
    if route.system_id is not None:
        session.begin(of_mission(route.system_id))

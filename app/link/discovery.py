"""Vehicle selection: the only vehicle on the link, or the one with the configured system id."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Mapping, Sequence
from typing import Any, TypeVar

from mavsdk.asyncio import Mavsdk

from sidelong.app.errors import InputError

SETTLING_S = 2.2  # two heartbeat periods: every vehicle present has sent one by then
_POLL_S = 0.1
_REFUSED_AFTER_S = 1.0

T = TypeVar("T")


async def the_vehicle(instance: Mavsdk, url: str, timeout_s: float, system_id: int | None) -> Any | None:
    """Return the MAVSDK system with ``system_id``, or the first one received; None if no vehicle is received.

    Raises:
        InputError: Only vehicles with other system ids are received.

    """
    first = await instance.first_autopilot(timeout_s)
    if first is None or system_id is None:
        return first
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s:
        vehicles = await _vehicles(instance)
        if system_id in vehicles:
            return vehicles[system_id]
        await asyncio.sleep(_POLL_S)
    found = await _described(await _vehicles(instance))
    raise InputError(f"{url}: system {system_id} sends nothing, only {found}; give another --system-id.")


async def unless_refused(search: Coroutine[Any, Any, T], urls: Sequence[str]) -> T:
    """Return what a search for vehicles returns, but end it when TCP servers among the links refuse connections.

    Raises:
        InputError: All links lead to TCP servers, and none of them takes connections.

    """
    searching = asyncio.ensure_future(search)
    try:
        await asyncio.wait((searching,), timeout=_REFUSED_AFTER_S)
        if not searching.done() and all([await _is_refused(url) for url in urls]):
            raise InputError(
                f"{' and '.join(urls)}: connection refused; start the autopilot first, or correct the URL."
            )
        return await searching
    finally:
        searching.cancel()


async def _is_refused(url: str) -> bool:
    scheme, _, address = url.partition("://")
    host, _, port = address.rpartition(":")
    if scheme != "tcpout":
        return False
    try:
        _, writer = await asyncio.wait_for(asyncio.open_connection(host, int(port)), _REFUSED_AFTER_S)
    except ConnectionRefusedError:
        return True
    except (OSError, TimeoutError):
        return False
    writer.close()
    return False


async def check_alone(instance: Mavsdk, url: str, until_s: float) -> None:
    """Listen for other vehicles until then, on the monotonic clock. Raises InputError when there are several."""
    await asyncio.sleep(max(0.0, until_s - time.monotonic()))
    vehicles = await _vehicles(instance)
    if len(vehicles) > 1:
        found = await _described(vehicles)
        raise InputError(
            f"{url}: several vehicles share the link: {found}; select one with --system-id or link.system_id."
        )


async def _vehicles(instance: Mavsdk) -> dict[int, Any]:
    systems: Sequence[Any] = await instance.get_systems()
    return {await system.get_system_id(): system for system in systems if await system.has_autopilot()}


async def _described(vehicles: Mapping[int, Any]) -> str:
    described = []
    for system_id, vehicle in sorted(vehicles.items()):
        kinds = [(await vehicle.autopilot_type()).name, (await vehicle.vehicle_type()).name]
        described.append(f"system {system_id} ({', '.join(kind.replace('_', ' ').lower() for kind in kinds)})")
    return ", ".join(described)

"""Vehicle selection: the only vehicle on the link, or the one with the configured system id."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from typing import Any

from mavsdk.asyncio import Mavsdk

from sidelong.app.errors import InputError

SETTLING_S = 2.2  # two heartbeat periods: every vehicle present has sent one by then
_POLL_S = 0.1


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

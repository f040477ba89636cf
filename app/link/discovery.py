"""Which vehicle is meant: the one that is there, or the one that was named."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from mavsdk.asyncio import Mavsdk

from app.errors import InputError

SETTLING_S = 2.2  # two heartbeats: who is there has spoken by then
_POLL_S = 0.1


async def the_vehicle(
    instance: Mavsdk, url: str, timeout_s: float, system_id: int | None, settling_s: float = SETTLING_S
) -> Any | None:
    """Return MAVSDK's system of the vehicle with ``system_id``, or of the only one there; None when none is heard.

    settling_s: how long to listen for others after the first. Raises InputError when there are several, or only
    others than the one named.
    """
    first = await instance.first_autopilot(timeout_s)
    if first is None:
        return None
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + (settling_s if system_id is None else timeout_s)
    while True:
        vehicles = await _vehicles(instance)
        if system_id in vehicles:
            return vehicles[system_id]
        if loop.time() >= deadline_s:
            break
        await asyncio.sleep(_POLL_S)
    if system_id is None and len(vehicles) <= 1:
        return first
    heard = ", ".join([await _described(number, vehicle) for number, vehicle in sorted(vehicles.items())])
    if system_id is None:
        raise InputError(f"{url}: several vehicles are heard: {heard}; name one by --system-id or link.system_id.")
    raise InputError(f"{url}: system {system_id} is not heard, only {heard}; give another --system-id.")


async def _vehicles(instance: Mavsdk) -> dict[int, Any]:
    systems: Sequence[Any] = await instance.get_systems()
    return {await system.get_system_id(): system for system in systems if await system.has_autopilot()}


async def _described(system_id: int, vehicle: Any) -> str:
    kinds = [(await vehicle.autopilot_type()).name, (await vehicle.vehicle_type()).name]
    return f"system {system_id} ({', '.join(kind.replace('_', ' ').lower() for kind in kinds)})"

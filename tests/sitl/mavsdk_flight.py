"""A plain MAVSDK script: python mavsdk_flight.py FLAVOUR URL. Prints what it saw as JSON.

It runs in a process of its own because MAVSDK aborts the process that lets its objects die in the wrong order.
"""

import asyncio
import json
import math
import sys

import mavsdk.logging
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionItem, MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

HOMES_DEG = {"arduplane": (-35.3632621, 149.1652370), "px4": (47.3977419, 8.5455938)}
TAKEOFF, WAYPOINT, LOITER = 22, 16, 17


mavsdk.logging.log_subscribe(lambda _level, _message, _file, _line: True)  # no lines of its own on stdout


async def fly(flavour, url):
    """Upload, arm, start, follow the progress to the loiter, go back one item by command."""
    latitude_deg, longitude_deg = HOMES_DEG[flavour]
    degree_east_m = 111_320.0 * math.cos(math.radians(latitude_deg))

    def item(seq, command, east_m=0.0, north_m=0.0, param1=0.0, param3=0.0):
        x = round((latitude_deg + north_m / 111_200.0) * 1e7)
        y = round((longitude_deg + east_m / degree_east_m) * 1e7)
        return MissionItem(
            seq=seq,
            frame=6,
            command=command,
            current=int(seq == 0),
            autocontinue=1,
            param1=param1,
            param3=param3,
            x=x,
            y=y,
            z=80.0,
            mission_type=0,
        )

    flown = [(TAKEOFF, 0, 0, 15.0, 0), (WAYPOINT, 300, 0), (WAYPOINT, 300, 500), (LOITER, 300, 800, 0, -90.0)]
    if flavour == "arduplane":
        flown.insert(0, (WAYPOINT, 0, 0))
    last = len(flown) - 1
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await sdk.add_any_connection(url)
    system = await sdk.first_autopilot(10.0)
    assert system is not None
    action, mission, telemetry = ActionAsync(system), MissionRawAsync(system), TelemetryAsync(system)
    async for health in telemetry.subscribe_health():
        if health.is_armable and health.is_home_position_ok:
            break
    if flavour == "px4":
        await ParamAsync(system).set_param_int("MIS_TKO_LAND_REQ", 0)
    await mission.upload_mission([item(seq, *each) for seq, each in enumerate(flown)])
    commands = [back.command for back in await mission.download_mission()]
    await action.arm()
    await mission.start_mission()
    seen = []
    async for progress in mission.subscribe_mission_progress():
        seen.append(progress.current)
        if seen.count(last) == 1 and progress.current == last:
            await mission.set_current_mission_item(last - 2)
        elif last in seen:
            break
    position = await telemetry.position()
    sdk.destroy()
    return {"seen": seen, "commands": commands, "height_m": position.relative_altitude_m}


if __name__ == "__main__":
    print(json.dumps(asyncio.run(fly(*sys.argv[1:]))))

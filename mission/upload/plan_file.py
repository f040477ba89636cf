"""QGroundControl's .plan files: a mission with its fences, to look at, or to fly without us.

Source: <https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html>.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.upload.fences import Outline
from sidelong.mission.upload.items import FRAME_GLOBAL
from sidelong.mission.upload.mission_item import MissionItem

_ALTITUDE_MODE_RELATIVE, _ALTITUDE_MODE_ABSOLUTE = 1, 2
_FIXED_WING = 1  # MAV_TYPE


def plan_file(
    items: Sequence[MissionItem],
    plane: LocalPlane,
    home_altitude_m: float,
    airspeed_m_s: float,
    mav_autopilot: int,
    keep_in: Sequence[Outline] = (),
    keep_out: Sequence[Outline] = (),
) -> str:
    """Return the text of a QGroundControl .plan file, version 1, with home at the plane's origin.

    Args:
        items: Mission items without a home item: the file has a field of its own for it, and whatever loads it for
            ArduPilot puts home at 0.
        home_altitude_m: Altitude of home above mean sea level, m.
        keep_in: Outlines of inclusion fences, (east, north) m.
        keep_out: Outlines of exclusion fences, (east, north) m.
    """
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "sidelong",
        "mission": {
            "version": 2,
            "firmwareType": mav_autopilot,
            "vehicleType": _FIXED_WING,
            "cruiseSpeed": airspeed_m_s,
            "hoverSpeed": airspeed_m_s,
            "globalPlanAltitudeMode": _ALTITUDE_MODE_RELATIVE,
            "plannedHomePosition": [plane.origin_latitude_deg, plane.origin_longitude_deg, home_altitude_m],
            "items": [_simple_item(number, item) for number, item in enumerate(items, 1)],
        },
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                *(_polygon(outline, plane, inclusion=True) for outline in keep_in),
                *(_polygon(outline, plane, inclusion=False) for outline in keep_out),
            ],
        },
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _simple_item(number: int, item: MissionItem) -> dict[str, Any]:
    params = (item.param1, item.param2, item.param3, item.param4)
    return {
        "type": "SimpleItem",
        "doJumpId": number,
        "command": item.command,
        "frame": item.frame,
        "autoContinue": bool(item.autocontinue),
        "params": [
            *(None if math.isnan(param) else param for param in params),
            *item.latitude_longitude_deg,
            item.z,
        ],
        "Altitude": item.z,
        "AltitudeMode": _ALTITUDE_MODE_ABSOLUTE if item.frame == FRAME_GLOBAL else _ALTITUDE_MODE_RELATIVE,
        "AMSLAltAboveTerrain": None,
    }


def _polygon(outline: Outline, plane: LocalPlane, inclusion: bool) -> dict[str, Any]:
    """Return the polygon, its corners clockwise as the format has them."""
    following = (*outline[1:], outline[0])
    twice_area_m2 = sum(e0 * n1 - e1 * n0 for (e0, n0), (e1, n1) in zip(outline, following, strict=True))
    clockwise = outline[::-1] if twice_area_m2 > 0.0 else outline
    return {
        "version": 1,
        "inclusion": inclusion,
        "polygon": [list(plane.latitude_longitude_deg(*corner)) for corner in clockwise],
    }

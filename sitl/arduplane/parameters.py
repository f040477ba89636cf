"""ArduPlane's parameters."""

from __future__ import annotations

import math

from sidelong.sitl.protocol.parameters import INT8, INT16, INT32, REAL32, Parameters
from sidelong.sitl.settings import Settings


def arduplane_parameters(settings: Settings) -> Parameters:
    """Return the parameters a ground program looks at, with the stock simulator's values."""
    airspeed_m_s = settings.airspeed_m_s
    table: dict[str, tuple[int, float]] = {
        "AIRSPEED_CRUISE": (REAL32, airspeed_m_s),
        "AIRSPEED_MIN": (INT16, math.floor(min(10.0, 0.7 * airspeed_m_s))),
        "AIRSPEED_MAX": (INT16, math.ceil(max(30.0, 1.35 * airspeed_m_s))),
        "ROLL_LIMIT_DEG": (REAL32, 65.0),
        "WP_LOITER_RAD": (INT16, 80.0),
        "WP_RADIUS": (INT16, 50.0),
        "RTL_RADIUS": (INT16, 0.0),
        "RTL_ALTITUDE": (REAL32, 100.0),
        "TKOFF_ALT": (INT16, 50.0),
        "NAVL1_PERIOD": (REAL32, 17.0),
        "NAVL1_DAMPING": (REAL32, 0.75),
        "NAVL1_XTRACK_I": (REAL32, 0.02),
        "FS_GCS_ENABL": (INT8, 0.0),
        "FS_LONG_ACTN": (INT8, 0.0),
        "FS_LONG_TIMEOUT": (REAL32, 5.0),
        "FS_SHORT_ACTN": (INT8, 0.0),
        "FS_SHORT_TIMEOUT": (REAL32, 1.5),
        "MAV_GCS_SYSID": (INT16, 255.0),
        "MAV_SYSID": (INT16, settings.system_id),
        "FENCE_ENABLE": (INT8, 0.0),
        "FENCE_ACTION": (INT8, 1.0),
        "FENCE_TOTAL": (INT8, 0.0),
        "MIS_RESTART": (INT8, 0.0),
        "MIS_TOTAL": (INT16, 0.0),
        "RNGFND1_TYPE": (INT8, 0.0),
        "STAT_RUNTIME": (INT32, 0.0),
    }
    return Parameters(table, bytewise=False)

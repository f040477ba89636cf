"""ArduPlane's parameters."""

from __future__ import annotations

import math

from sidelong.sitl.protocol.parameters import INT8, INT16, INT32, REAL32, Parameters
from sidelong.sitl.settings import Release, Settings

_FORMER: dict[str, tuple[Release, str, int, float]] = {  # renamed in, name before, its type and unit
    "AIRSPEED_CRUISE": ((4, 5), "TRIM_ARSPD_CM", INT32, 0.01),
    "AIRSPEED_MIN": ((4, 5), "ARSPD_FBW_MIN", INT16, 1.0),
    "AIRSPEED_MAX": ((4, 5), "ARSPD_FBW_MAX", INT16, 1.0),
    "ROLL_LIMIT_DEG": ((4, 5), "LIM_ROLL_CD", INT16, 0.01),
    "RTL_ALTITUDE": ((4, 5), "ALT_HOLD_RTL", INT32, 0.01),
    "MAV_GCS_SYSID": ((4, 7), "SYSID_MYGCS", INT16, 1.0),
    "MAV_SYSID": ((4, 7), "SYSID_THISMAV", INT16, 1.0),
}


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
        "ARMING_MIS_ITEMS": (INT32, 0.0),
        "MIS_RESTART": (INT8, 0.0),
        "MIS_TOTAL": (INT16, 0.0),
        "RNGFND1_TYPE": (INT8, 0.0),
        "STAT_RUNTIME": (INT32, 0.0),
    }
    release, former = settings.release_or_newest, {}
    for name, (renamed_in, old_name, kind, unit) in _FORMER.items():
        if release < renamed_in:
            table[old_name] = (kind, table.pop(name)[1] / unit)
            former[name] = (old_name, unit)
    return Parameters(table, bytewise=False, former=former)

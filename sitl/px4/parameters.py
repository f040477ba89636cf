"""PX4's parameters."""

from __future__ import annotations

from sidelong.sitl.protocol.parameters import INT32, REAL32, Parameters
from sidelong.sitl.settings import Settings


def px4_parameters(settings: Settings) -> Parameters:
    """Return the parameters a ground program looks at, with the stock simulator's values."""
    airspeed_m_s = settings.airspeed_m_s
    table: dict[str, tuple[int, float]] = {
        "FW_AIRSPD_MIN": (REAL32, min(10.0, 0.7 * airspeed_m_s)),
        "FW_AIRSPD_MAX": (REAL32, max(20.0, 1.35 * airspeed_m_s)),
        "FW_AIRSPD_TRIM": (REAL32, airspeed_m_s),
        "FW_R_LIM": (REAL32, 50.0),
        "NAV_LOITER_RAD": (REAL32, 80.0),
        "NAV_ACC_RAD": (REAL32, 10.0),
        "NAV_FW_ALT_RAD": (REAL32, 10.0),
        "NPFG_PERIOD": (REAL32, 10.0),
        "NPFG_DAMPING": (REAL32, 0.7071),
        "NAV_DLL_ACT": (INT32, 0),
        "NAV_RCL_ACT": (INT32, 2),
        "COM_DL_LOSS_T": (INT32, 10),
        "COM_FAIL_ACT_T": (REAL32, 5.0),
        "COM_RC_IN_MODE": (INT32, 1),
        "COM_OF_LOSS_T": (REAL32, 1.0),
        "MIS_TKO_LAND_REQ": (INT32, 2),
        "MIS_TAKEOFF_ALT": (REAL32, 30.0),
        "FW_LND_ANG": (REAL32, 5.0),
        "RTL_RETURN_ALT": (REAL32, 60.0),
        "RTL_LOITER_RAD": (REAL32, 80.0),
        "GF_ACTION": (INT32, 2),
        "GF_MAX_HOR_DIST": (REAL32, 0.0),
        "GF_MAX_VER_DIST": (REAL32, 0.0),
        "MAV_SYS_ID": (INT32, settings.system_id),
        "MAV_TYPE": (INT32, 1),
    }
    release = settings.release_or_newest
    if release < (1, 14):
        del table["MIS_TKO_LAND_REQ"]
    return Parameters(table, bytewise=True, reports_errors=release >= (1, 18))

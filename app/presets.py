"""Presets: common airframes by their published parameter files, and payloads by their factory addresses.

The range band goes with the radius: about ten radii to Dmax is what the transitions between circles need. Roll rate
and height are left at the defaults; a preset is where to begin, the aircraft's own figures come first.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Preset:
    """about: what it is, in half a line. source: where the figures are published."""

    about: str
    source: str
    airspeed_m_s: float
    radius_m: float
    bank_max_deg: float
    range_max_m: float = 500.0

    def values(self) -> dict[str, dict[str, float]]:
        """Return the keys that it sets, by section."""
        return {
            "aircraft": {
                "airspeed_m_s": self.airspeed_m_s,
                "radius_m": self.radius_m,
                "bank_max_deg": self.bank_max_deg,
            },
            "requirement": {"range_max_m": self.range_max_m},
        }


_ARDUPILOT = "ArduPilot Tools/Frame_params"

PRESETS = {
    "parrot-disco": Preset(
        "Parrot Disco, foam flying wing of 1.15 m", f"{_ARDUPILOT}/Parrot_Disco", 14.0, 30.0, 55.0
    ),
    "3dr-aero": Preset("3DR Aero, foam pusher", f"{_ARDUPILOT}/3DR_Aero_RTF.param", 15.0, 73.0, 50.0, 750.0),
    "skywalker-x8": Preset(
        "Skywalker X8, foam flying wing of 2.1 m", f"{_ARDUPILOT}/SkyWalkerX8.param", 16.0, 50.0, 35.0
    ),
    "arduplane-sitl": Preset(
        "the stock ArduPlane simulation", "ArduPilot Tools/autotest/models/plane.parm", 22.0, 80.0, 65.0, 850.0
    ),
    "px4-sih": Preset(
        "the PX4 SIH fixed wing",
        "PX4 SIH rc_plane, FW_R_LIM and NAV_LOITER_RAD as they come",
        15.5,
        80.0,
        50.0,
        850.0,
    ),
}


@dataclass(frozen=True, slots=True)
class PayloadPreset:
    """A payload's protocol and its address as delivered.

    Attributes:
        about: what it is, in half a line.
        kind: value of ``payload.kind``.
        url: value of ``payload.url``.
        source: where the address is published.
        pan_limit_deg: value of ``aircraft.pan_limit_deg``; None: it pans all around, or its manual gives no limit.
    """

    about: str
    kind: str
    url: str
    source: str
    pan_limit_deg: float | None = None
    has_laser: bool = True

    def values(self) -> dict[str, dict[str, str | float]]:
        """Return the keys that it sets, by section; without a laser, the range comes from flat ground."""
        found: dict[str, dict[str, str | float]] = {"payload": {"kind": self.kind, "url": self.url}}
        if not self.has_laser:
            found |= {"terrain": {"flat": True}, "simulation": {"laser": False}}
        if self.pan_limit_deg is not None:
            found["aircraft"] = {"pan_limit_deg": self.pan_limit_deg}
        return found


_SIYI, _GREMSY = "udp://192.168.144.25:37260", "udp://192.168.55.1:14566"
_SERIAL = "serial:///dev/ttyUSB0:115200"
_LASERLESS = "no laser: range from flat ground, or from elevation data (terrain.folder)"
_ARDUPILOT_MOUNT = "ArduPilot AP_Mount"

PAYLOAD_PRESETS = {
    "siyi-zt30": PayloadPreset("SIYI ZT30, four sensors with laser", "siyi", _SIYI, "SIYI's manuals"),
    "siyi-zt6": PayloadPreset(f"SIYI ZT6, {_LASERLESS}", "siyi", _SIYI, "SIYI's manuals", has_laser=False),
    "siyi-a8-mini": PayloadPreset(
        f"SIYI A8 mini, {_LASERLESS}", "siyi", _SIYI, "A8 mini manual v1.5", 135.0, has_laser=False
    ),
    "viewpro-tcp": PayloadPreset(
        "Viewpro with a laser, by Ethernet", "viewpro", "tcp://192.168.2.119:2000", "Viewpro's TCP control document"
    ),
    "viewpro-serial": PayloadPreset(
        "Viewpro with a laser, by a serial line", "viewpro", _SERIAL, f"{_ARDUPILOT_MOUNT}_Viewpro"
    ),
    "topotek-serial": PayloadPreset(
        "Topotek with a laser, by a serial line", "topotek", _SERIAL, f"{_ARDUPILOT_MOUNT}_Topotek"
    ),
    "gremsy-vio": PayloadPreset("Gremsy VIO, laser", "gremsy", _GREMSY, "Gremsy PayloadSdk"),
    "gremsy-orus-l": PayloadPreset("Gremsy Orus-L, laser", "gremsy", _GREMSY, "Gremsy PayloadSdk"),
}

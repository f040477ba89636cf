"""ArduPlane's own simulator with an airframe of JSBSim: a program that takes ArduPlane's options.

    python -m tests.autopilot.jsbsim_airframe ARDUPLANE AIRCRAFT.xml OPTION...

starts ARDUPLANE with the options and answers its JSON interface (extra ``jsbsim``). AIRCRAFT.xml is a model of JSBSim
whose engines and systems lie next to it, such as Tools/autotest/aircraft/Rascal/Rascal.xml of ArduPilot's source
tree; aileron, elevator, throttle and rudder are servos 1 to 4. Wind, and whether there is turbulence (moderate,
MIL-F-8785C), are read from SIM_WIND_SPD, SIM_WIND_DIR and SIM_WIND_TURB in the file own.parm.

Source: libraries/SITL/examples/JSON/readme.md of ArduPilot; JSBSim reference manual.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.autopilot.real_vehicle import ROOT, Program

FT_M, KT_M_S = 0.3048, 0.514444
_PORT, _PER_INSTANCE = 9002, 10
_PACKET, _MAGIC = struct.Struct("<HHI16H"), 18458
_STEP_S, _STEPS = 1.0 / 1000.0, 5  # of JSBSim, and how many of them an answer takes
_MILSPEC, _MODERATE_FT_S, _SEVERITY = 3, 30.0 * KT_M_S / FT_M, 4
_MODULE = "tests.autopilot.jsbsim_airframe"
_SHELTERED_M = 10.0  # below half of it there is no wind: gusts would turn it over on the ground
_EARTH_M = 6_378_137.0


def arduplane_on(arduplane: Path, aircraft: Path, script: Path) -> Program:
    """Write a script that starts ArduPlane on an airframe of JSBSim, and return it as a program."""
    stock = arduplane.resolve().parents[3] / "Tools/autotest/default_params/plane-jsbsim.parm"
    command = f'"{sys.executable}" -m {_MODULE} "{arduplane.resolve()}" "{aircraft.resolve()}" "$@"'
    script.write_text(
        f'#!/bin/sh\ncat "{stock}" own.parm > all.parm\nmv all.parm own.parm\nPYTHONPATH="{ROOT}" exec {command}\n'
    )
    script.chmod(0o755)
    return Program("arduplane", script, f"arduplane on {aircraft.stem}")


class Airframe:
    """JSBSim's aircraft, on the ground at home. parameters: of the vehicle; its wind and turbulence are JSBSim's."""

    def __init__(self, aircraft: Path, home: tuple[float, ...], parameters: dict[str, float]) -> None:
        import jsbsim  # noqa: PLC0415  # an extra

        self._latitude_deg, self._longitude_deg, self._altitude_m, heading_deg = home
        folder = aircraft.parent
        fdm = self._fdm = jsbsim.FGFDMExec(str(folder.parent))
        fdm.set_debug_level(0)
        fdm.set_aircraft_path(".")
        fdm.set_engine_path(f"{folder.name}/Engines")
        fdm.set_systems_path(f"{folder.name}/Systems")
        assert fdm.load_model(folder.name), f"{aircraft} is no aircraft of JSBSim"
        fdm.set_dt(_STEP_S)
        initial = {
            "lat-geod-deg": self._latitude_deg,
            "long-gc-deg": self._longitude_deg,
            "terrain-elevation-ft": self._altitude_m / FT_M,
            "h-agl-ft": 1.3 / FT_M,
            "theta-deg": 13.0,
            "psi-true-deg": heading_deg,
        }
        for name, value in initial.items():
            fdm[f"ic/{name}"] = value
        assert fdm.run_ic()
        speed_ft_s = parameters.get("SIM_WIND_SPD", 0.0) / FT_M
        from_rad = math.radians(parameters.get("SIM_WIND_DIR", 180.0))
        self._wind_ft_s = -speed_ft_s * math.cos(from_rad), -speed_ft_s * math.sin(from_rad)
        self._turbulence = _MILSPEC if parameters.get("SIM_WIND_TURB", 0.0) > 0.0 else 0
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = _MODERATE_FT_S
        fdm["atmosphere/turbulence/milspec/severity"] = _SEVERITY
        fdm["propulsion/set-running"] = -1

    def advance(self, pwm_us: Sequence[int]) -> dict[str, Any]:
        """Fly on with the servos' pulses; return the state as ArduPlane's JSON interface takes it."""
        fdm = self._fdm
        for number, name in ((0, "aileron"), (1, "elevator"), (3, "rudder")):
            fdm[f"fcs/{name}-cmd-norm"] = (pwm_us[number] - 1500) / 500.0
        share = min(max(fdm["position/h-agl-ft"] * FT_M / _SHELTERED_M - 0.5, 0.0), 1.0)
        fdm["atmosphere/wind-north-fps"], fdm["atmosphere/wind-east-fps"] = (share * one for one in self._wind_ft_s)
        fdm["atmosphere/turb-type"] = self._turbulence if share >= 1.0 else 0
        fdm["fcs/throttle-cmd-norm"] = min(max((pwm_us[2] - 1000) / 1000.0, 0.0), 1.0)
        for _ in range(_STEPS):
            fdm.run()
        north_m = _EARTH_M * math.radians(fdm["position/lat-geod-deg"] - self._latitude_deg)
        east_m = _EARTH_M * math.radians(fdm["position/long-gc-deg"] - self._longitude_deg)
        east_m *= math.cos(math.radians(self._latitude_deg))
        height_m = fdm["position/h-sl-ft"] * FT_M - self._altitude_m
        return {
            "timestamp": fdm.get_sim_time(),
            "imu": {
                "gyro": [fdm[f"velocities/{axis}-rad_sec"] for axis in "pqr"],
                "accel_body": [FT_M * fdm[f"accelerations/a-pilot-{axis}-ft_sec2"] for axis in "xyz"],
            },
            "position": [north_m, east_m, -height_m],
            "attitude": [fdm[f"attitude/{angle}-rad"] for angle in ("phi", "theta", "psi")],
            "velocity": [FT_M * fdm[f"velocities/v-{axis}-fps"] for axis in ("north", "east", "down")],
            "airspeed": KT_M_S * fdm["velocities/vc-kts"],
        }


def main() -> None:
    arduplane, aircraft, *options = sys.argv[1:]
    options[options.index("--model") + 1] = "JSON:127.0.0.1"
    home = tuple(map(float, options[options.index("--home") + 1].split(",")))
    lines = (line.split() for line in Path("own.parm").read_text().splitlines())
    parameters = {words[0]: float(words[1]) for words in lines if len(words) > 1 and words[0].startswith("SIM_WIND")}
    airframe = Airframe(Path(aircraft), home, parameters)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", _PORT + _PER_INSTANCE * int(options[options.index("-I") + 1])))
        link.settimeout(1.0)
        with subprocess.Popen([arduplane, *options]) as process:
            answer_for(link, airframe, process)
    sys.exit(process.returncode)


def answer_for(link: socket.socket, airframe: Airframe, process: subprocess.Popen[bytes]) -> None:
    """Answer each packet of the servos with the state a frame later, until the program ends."""
    count, answer = -1, ""
    while process.poll() is None:
        try:
            data, peer = link.recvfrom(1024)
        except TimeoutError:
            continue
        magic, _, number, *pwm_us = _PACKET.unpack(data[: _PACKET.size])
        if magic == _MAGIC and number != count:  # else a repetition: the answer was lost
            count = number
            answer = json.dumps(airframe.advance(pwm_us), separators=(",", ":"))  # all that its parser takes
        link.sendto(f"\n{answer}\n".encode(), peer)


if __name__ == "__main__":
    main()

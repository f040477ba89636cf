"""Someone's own SITL program with payload and target, and the configuration for its stock aircraft."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
AIRCRAFT = {"arduplane": (22, 80, 60), "px4": (15, 60, 45)}  # of the stock simulators: m/s, m, degrees
FLAVOURS = tuple(AIRCRAFT)
_SECOND_PORT = {"arduplane": 3, "px4": 14030 - 14540}  # from that of the first link; the payload has another one
_ENDS_WITHIN_S = 20.0


class RealVehicle:
    """The program that SIDELONG_ARDUPLANE or SIDELONG_PX4 names; skips where none is named. Use as ``with``.

    ``urls``: of its first and its second link, as the program serves them; ``payload_urls``: of a payload that has to
    be met by itself.
    """

    def __init__(self, flavour: str, *options: object) -> None:
        name = f"SIDELONG_{flavour.upper()}"
        if not os.environ.get(name):
            pytest.skip(f"{name} does not name a SITL program")
        command = (
            sys.executable,
            "-m",
            "sidelong.sitl",
            "--autopilot",
            flavour,
            "--binary",
            os.environ[name],
            *options,
        )
        self._command, self._second_port = list(map(str, command)), _SECOND_PORT[flavour]

    def __enter__(self) -> RealVehicle:
        self._sitl = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        )
        assert self._sitl.stdout is not None
        *self.payload_urls, first = (word for word in self._sitl.stdout.readline().split() if "://" in word)
        host, _, port = first.rpartition(":")
        self.urls = [first, f"{host}:{int(port) + self._second_port}"]
        return self

    def __exit__(self, *_: object) -> None:
        self._sitl.send_signal(signal.SIGTERM)
        try:
            assert self._sitl.wait(_ENDS_WITHIN_S) == 0
        finally:
            self._sitl.kill()


def configured(path: Path, flavour: str, more: str = "") -> Path:
    """Write a configuration for the stock aircraft; ``more`` goes on in its section."""
    airspeed_m_s, radius_m, bank_max_deg = AIRCRAFT[flavour]
    path.write_text(
        f"[aircraft]\nairspeed_m_s = {airspeed_m_s}\nradius_m = {radius_m}\nbank_max_deg = {bank_max_deg}\n{more}"
    )
    return path

"""Someone's own SITL program with payload and target, and the configuration for its stock aircraft."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
AIRCRAFT = {"arduplane": (22, 80, 60), "px4": (15, 60, 45)}  # of the stock simulators: m/s, m, degrees
_SECOND_PORT = {"arduplane": 3, "px4": 14030 - 14540}  # from that of the first link; the payload has another one
_ENDS_WITHIN_S = 20.0


class Program(str):
    """A flavour with the SITL program that flies it.

    Attributes:
        path: The program; None: there is none, and its tests are skipped.
        label: What it is called before it reports its version.
    """

    path: Path | None
    label: str

    def __new__(cls, flavour: str, path: Path | None, label: str) -> Program:
        """Return the flavour with its program."""
        program = super().__new__(cls, flavour)
        program.path, program.label = path, label
        return program


def programs(environment: Mapping[str, str]) -> list[Any]:
    """Return the programs as parameters of tests: those in the folder SIDELONG_PROGRAMS, or one of each flavour."""
    folder = environment.get("SIDELONG_PROGRAMS")
    if folder is None:
        named = [(one, environment.get(f"SIDELONG_{one.upper()}")) for one in AIRCRAFT]
        return [pytest.param(Program(one, Path(path) if path else None, one), id=one) for one, path in named]
    found = sorted(path for path in Path(folder).rglob("*") if path.name in AIRCRAFT and path.is_file())
    labels = [str(path.relative_to(folder)) for path in found]
    return [
        pytest.param(Program(path.name, path, label), id=label) for path, label in zip(found, labels, strict=True)
    ]


FLAVOURS = programs(os.environ)


def arduplane_with(path: Path, script: Path, parameters: str, options: str = "") -> Program:
    """Write a script that starts ArduPlane with more parameters and options, and return it as a program."""
    stock = path.resolve().parents[3] / "Tools/autotest/models/plane.parm"
    more = script.with_suffix(".parm")
    more.write_text(parameters)
    script.write_text(f'#!/bin/sh\ncat "{stock}" "{more}" >> own.parm\nexec "{path.resolve()}" "$@" {options}\n')
    script.chmod(0o755)
    return Program("arduplane", script, "arduplane")


class RealVehicle:
    """A SITL program with payload and target; skips where none is named. Use as ``with``.

    ``urls``: of its first and its second link, as the program serves them; ``payload_urls``: of a payload that has to
    be met on its own.
    """

    def __init__(self, flavour: Program, *options: object) -> None:
        if flavour.path is None:
            pytest.skip(f"SIDELONG_{flavour.upper()} does not name a SITL program")
        command = (
            sys.executable,
            "-m",
            "sidelong.sitl",
            "--autopilot",
            flavour,
            "--binary",
            flavour.path,
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

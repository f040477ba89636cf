"""Planners, payloads and autopilots of another distribution, installed for real in a folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command_line import FEW_FLIGHTS

ROOT = Path(__file__).resolve().parents[2]
MODULE = """
from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.payload.driver import PayloadKind
from sidelong.app.payload.siyi import SiyiDriver
from sidelong.app.planners.planner_kind import Paper

class Cautious(Paper):
    name = "cautious"
    about = "the published method under another name"

class Fork(ArduPlane):
    name = "Fork"
    mav_autopilot = 77

camera = PayloadKind("camera", "a camera", "udp://192.168.0.9:1", SiyiDriver)
nameless = object()
"""
POINTS = """
[sidelong.planners]
cautious = another_package:Cautious
[sidelong.payloads]
camera = another_package:camera
[sidelong.autopilots]
fork = another_package:Fork
"""
USED = """
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.config import Config, config_from
from sidelong.app.payload.registry import kind_by_name
from sidelong.app.planners.registry import planner_by_name
config = config_from({"planner": {"name": "cautious"}, "payload": {"kind": "camera"}}, "test")
print(planner_by_name(config.planner.name).name, kind_by_name(config.payload.kind).url)
print(autopilot_by_mav_autopilot(77).name, autopilot_by_mav_autopilot(3).name)
"""


@pytest.fixture
def python(tmp_path):
    """Return what runs a program next to a distribution with these entry points."""

    def run(points, *program):
        (tmp_path / "another_package.py").write_text(MODULE)
        info = tmp_path / "another-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: another\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(points)
        environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
        return subprocess.run(
            [sys.executable, *program], env=environment, capture_output=True, text=True, check=False, cwd=tmp_path
        )

    return run


def test_what_other_distributions_add_is_configured_like_our_own(python):
    ran = python(POINTS, "-c", USED)
    assert ran.stdout.split() == ["cautious", "udp://192.168.0.9:1", "Fork", "ArduPlane"], ran.stderr


def test_check_flies_a_planner_of_another_distribution(python):
    ran = python(POINTS, "-c", FEW_FLIGHTS, "check", "--planner", "cautious")
    assert ran.returncode == 0, ran.stderr
    assert "predicted from 3 simulated flights" in ran.stdout
    assert "feasible" in ran.stdout


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (
            "[sidelong.planners]\nlost = another_package:Lost\n",
            "another: entry point lost of sidelong.planners cannot",
        ),
        ("[sidelong.planners]\nnone = another_package:nameless\n", "lacks name, about, unflyable"),
        (
            "[sidelong.planners]\ntwice = sidelong.app.planners.planner_kind:Paper\n",
            "has the name 'paper', which is taken",
        ),
    ],
)
def test_a_broken_distribution_is_named_and_left_out(python, points, words):
    ran = python(points, "-m", "sidelong.app", "launch", "--help")
    assert ran.returncode == 0
    assert "predictive or paper" in ran.stdout
    assert words in ran.stderr
    assert ran.stderr.count("it is left out. Repair it or uninstall it.") == 1
    assert "Traceback" not in ran.stderr


def test_a_flight_loads_neither_figures_nor_other_filters():
    program = "import sidelong.app.commands.flying, sidelong.app.serve.resident, sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not set(ran.stdout.split()) & {
        "matplotlib",
        "filterpy",
        "scipy",
        "pyarrow",
        "rasterio",
        "distributed",
    }

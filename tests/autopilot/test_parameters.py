"""Parameters that stand in the way: refused with the reason, or set for the flight and set back."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.udp


def test_launch_refuses_with_the_reason_then_sets_and_restores(vehicle_of, launch, tmp_path):
    vehicle = vehicle_of("px4")
    vehicle.do(lambda: vehicle.autopilot.parameters.set("NAV_DLL_ACT", 5))
    refused = launch(vehicle.url)
    assert refused.process.wait(90.0) == 2
    assert "NAV_DLL_ACT: 5: losing the link would end the flight" in refused.announced
    assert vehicle.autopilot.parameters["NAV_DLL_ACT"] == 5
    flying = launch(vehicle.url, "--set", "link.set_parameters=true")
    flying.wait_for("watched from now on")
    assert vehicle.autopilot.parameters["NAV_DLL_ACT"] == 0
    flying.end()
    assert vehicle.autopilot.parameters["NAV_DLL_ACT"] == 5


def test_connect_reports_what_parameters_mean(vehicle_of):
    vehicle = vehicle_of("arduplane")
    vehicle.do(lambda: vehicle.autopilot.parameters.set("FS_GCS_ENABL", 1))
    command = [Path(sys.executable).with_name("sidelong"), "connect", vehicle.url]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "FS_GCS_ENABL" in done.stdout
    assert "failsafe" in done.stdout

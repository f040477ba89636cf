"""Another station takes the vehicle: not one command once that is reported, and none ever again.

How soon, and by a mission, a circle, a mode in mid-upload or a restart: ``tests/exchange/test_flights.py``, without
sockets; given back: ``tests/exchange/test_resume.py``.
"""

import os

import pytest

pytestmark = pytest.mark.udp

TIMES = int(os.environ.get("TIMES", "1"))  # more of the same, with other seeds
WATCHED = "watched from now on"
ON_THE_WAY_S = 2.5  # of the vehicle's time: a quarter of a second at ten times the clock, on a busy machine


def commands_after(vehicle, announced_s):
    return [kind for time_s, kind in vehicle.commanded if time_s > announced_s + ON_THE_WAY_S]


@pytest.mark.parametrize("seed", range(1, TIMES + 1))
def test_another_station_changes_the_mode(vehicle_of, launch, seed):
    vehicle = vehicle_of("arduplane", seed, speed=10.0)
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    vehicle.wait(5.0 + 3.0 * seed)
    vehicle.do(lambda: vehicle.autopilot.set_mode(12))
    application.wait_for("commanding nothing more")
    announced_s = vehicle.simulation.time_s
    vehicle.wait(30.0)
    assert commands_after(vehicle, announced_s) == []
    summary = application.end()
    assert summary["outcome"].startswith("yielded")
    assert "changed to LOITER" in summary["outcome"]


LINK_FAILSAFE = {"arduplane": {"FS_GCS_ENABL": 1, "FS_LONG_ACTN": 1}, "px4": {"NAV_DLL_ACT": 2}}
LINK_REASON = {"arduplane": "GCS Failsafe", "px4": "GCS connection loss"}


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_companion_does_not_stand_in_for_a_silent_ground_station(vehicle_of, launch, flavour):
    vehicle = vehicle_of(flavour, speed=10.0)
    application = launch(vehicle.url, "--set", "link.role=companion")
    application.wait_for(WATCHED)

    def receive_a_station_for_the_last_time():
        for name, value in LINK_FAILSAFE[flavour].items():
            vehicle.autopilot.parameters.set(name, value)
        vehicle.autopilot.gcs_received_s = vehicle.autopilot.now_s

    vehicle.do(receive_a_station_for_the_last_time)
    application.wait_for("commanding nothing more")
    application.wait_for(f"by a failsafe of the autopilot: {LINK_REASON[flavour]}")
    announced_s = vehicle.simulation.time_s
    vehicle.wait(30.0)
    assert commands_after(vehicle, announced_s) == []
    assert application.end()["outcome"].startswith("yielded")

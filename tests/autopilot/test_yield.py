"""Another station takes the vehicle: not one command once that is reported, and none ever again.

How soon, and by a mission, a circle, a mode in mid-upload or a restart: ``tests/exchange/test_flights.py``, without
sockets.
"""

import os

import pytest

pytestmark = pytest.mark.udp

TIMES = int(os.environ.get("TIMES", "1"))  # more of the same, with other seeds
WATCHED = "watched from now on"
ON_THE_WAY_S = 2.5  # of the vehicle's time: a quarter of a second at ten times the clock, on a busy machine


def commands_after(vehicle, announced_s):
    return [kind for time_s, kind in vehicle.commanded if time_s > announced_s + ON_THE_WAY_S]


def assert_yielded(vehicle, application, act, words, seed=1):
    application.wait_for(WATCHED)
    vehicle.wait(5.0 + 3.0 * seed)
    vehicle.do(act)
    application.wait_for("commanding nothing more")
    announced_s = vehicle.simulation.time_s
    vehicle.wait(30.0)
    assert commands_after(vehicle, announced_s) == []
    summary = application.end()
    assert summary["outcome"].startswith("yielded")
    assert words in summary["outcome"]


@pytest.mark.parametrize("seed", range(1, TIMES + 1))
@pytest.mark.parametrize(
    ("flavour", "guidance", "mode", "name"),
    [
        ("arduplane", "mission", 12, "LOITER"),
        ("px4", "command", 0x05040000, "RTL"),
    ],
)
def test_another_station_changes_the_mode(vehicle_of, launch, flavour, guidance, mode, name, seed):
    vehicle = vehicle_of(flavour, seed, speed=10.0)
    application = launch(vehicle.url, "--guidance", guidance)
    assert_yielded(vehicle, application, lambda: vehicle.autopilot.set_mode(mode), f"changed to {name}", seed)


def test_the_pilot_takes_over_and_gives_back_and_is_left_alone(vehicle_of, launch):
    vehicle = vehicle_of("arduplane", speed=10.0)
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    vehicle.do(vehicle.simulation.pilot_takes_over)
    application.wait_for("commanding nothing more")
    vehicle.wait(5.0)
    given_back_s = vehicle.do(lambda: (vehicle.autopilot.set_mode(10), vehicle.simulation.time_s)[1])
    vehicle.wait(30.0)
    assert commands_after(vehicle, given_back_s) == []

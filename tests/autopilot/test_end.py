"""Ordered to end, it ends: within its bound, whatever the vehicle does."""

import json
import signal

import pytest

pytestmark = pytest.mark.udp

WATCHED = "watched from now on"
WIND_UP_S = 60.0  # the application's own bound


def test_before_it_flies_nothing_is_left(vehicle_of, launch):
    vehicle = vehicle_of("arduplane")
    application = launch(vehicle.url)
    application.wait_for("checking the vehicle")
    vehicle.deaf = True  # without its answers the checks would go on
    application.process.send_signal(signal.SIGTERM)
    assert application.process.wait(WIND_UP_S) == 130
    assert not list(application.out.iterdir())
    assert "Traceback" not in application.announced
    assert vehicle.commanded == [each for each in vehicle.commanded if each[1] == "COMMAND_LONG"]  # asked for streams


def test_with_a_vehicle_that_falls_silent_during_an_upload(vehicle_of, launch):
    vehicle = vehicle_of("px4")
    application = launch(vehicle.url)
    application.wait_for(WATCHED)

    def fall_silent():
        vehicle.deaf = True

    vehicle.at_item(1, fall_silent)
    application.wait_for("link lost")
    application.process.send_signal(signal.SIGINT)
    assert application.process.wait(WIND_UP_S) == 130
    ended = "interrupted by SIGINT: by its last message, the aircraft goes on circling where it is."
    assert ended in application.announced
    (run,) = application.out.iterdir()
    assert json.loads((run / "summary.json").read_text())["outcome"] == "interrupted"
    assert "was left off" not in application.announced
    assert "Traceback" not in application.announced

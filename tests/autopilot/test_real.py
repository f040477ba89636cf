"""Real autopilots, where their SITL programs are given; the simulated flavours fly the same.

SIDELONG_ARDUPLANE=/path/to/arduplane SIDELONG_PX4=/path/to/px4 python -m pytest tests/autopilot
SIDELONG_PROGRAMS=/path/to/programs python -m pytest tests/autopilot
"""

import os
import time

import pytest

from tests.autopilot.matrix import flight_row, upload_s, version_of
from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, configured

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(900)]  # they fly in little more than real time

SPEED = float(os.environ.get("REAL_SPEED", "3"))
WATCHED = "watched from now on"
DURATION_S, TARGET_SPEED_MAX_M_S = 300, 4


@pytest.fixture(params=FLAVOURS)
def fly(request, launch, tmp_path, record_property):
    """Return what launches on the user's own program with payload and target."""
    more = f"[requirement]\ntarget_speed_max_m_s = {TARGET_SPEED_MAX_M_S}\n"
    config = configured(tmp_path / "mission.toml", request.param, more)
    with RealVehicle(request.param, "--speed", SPEED, "--target-speed", TARGET_SPEED_MAX_M_S) as vehicle:
        record_property("version", version_of(vehicle.urls[0]))
        yield lambda *options: launch(vehicle.urls[0], str(config), *options)


@pytest.mark.parametrize("guidance", ["mission", "command"])
def test_a_flight(fly, guidance, record_property, request):
    if guidance == "command" and request.node.callspec.params["fly"] == "px4":
        pytest.skip("PX4 is not guided by command")
    flight = fly("--set", f"planner.guidance={guidance}", "--duration", str(DURATION_S), "--quiet")
    assert flight.process.wait(100.0 + 900.0 / SPEED) == 0, flight.announced
    summary = flight.end()
    assert summary["outcome"] == "completed"
    assert summary["time_in_band"] > 0.95
    assert summary["min_range_m"] > 90.0
    assert summary["upload_failures"] == 0
    moves_per_hour = 3600.0 * summary["moves"] / summary["duration_s"]
    side, band = summary["time_on_side"], summary["time_in_band"]
    uploads_s = upload_s(flight.run / "journal.jsonl")
    record_property("flight", flight_row(f"{guidance}, 5 minutes", side, band, moves_per_hour, uploads_s))


def test_a_killed_application_is_started_again_and_takes_the_circle_over(fly):
    first = fly()
    first.wait_for(WATCHED)
    first.kill()
    begin_s = time.monotonic()
    again = fly("--duration", "20")
    again.wait_for(WATCHED)
    print(f"watching again {time.monotonic() - begin_s:.1f} s after kill -9, load {os.getloadavg()[0]:.0f}")
    assert again.process.wait(120.0) == 0, again.announced
    assert "taking over the circle that is flown" in again.announced

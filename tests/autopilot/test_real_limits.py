"""A ground station lowers the bank limit of a real autopilot in flight, where SITL programs are given.

SIDELONG_ARDUPLANE=/path/to/arduplane python -m pytest tests/autopilot/test_real_limits.py -s
"""

import json
import math
import os
import time

import numpy as np
import pytest

from tests.autopilot.changing_relay import ChangingRelay
from tests.autopilot.real_vehicle import AIRCRAFT, FLAVOURS, RealVehicle, configured

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(1800)]

SPEED = float(os.environ.get("REAL_SPEED", "3"))
DURATION_S = 420
LIMIT_DEG = {"arduplane": ("ROLL_LIMIT_DEG", 25.0), "px4": ("FW_R_LIM", 22.0)}


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_lower_bank_limit_widens_the_circle_and_keeps_the_band(flavour, launch, tmp_path):
    config = configured(tmp_path / "mission.toml", flavour, "[requirement]\ntarget_speed_max_m_s = 4\n")
    truth, (name, limit_deg) = tmp_path / "truth.csv", LIMIT_DEG[flavour]
    airspeed_m_s, _, _ = AIRCRAFT[flavour]
    with (
        RealVehicle(flavour, "--speed", SPEED, "--target-speed", 4, "--truth", truth) as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
    ):
        flight = launch(relay.url, str(config), "--duration", str(DURATION_S))
        flight.wait_for("watched from now on")
        time.sleep(60.0 / SPEED)
        relay.set_parameter(name, limit_deg)
        assert flight.process.wait(200.0 + 1200.0 / SPEED) == 0, flight.announced
    assert "by its parameters it banks" in flight.announced
    lines = [json.loads(line) for line in (flight.run / "journal.jsonl").read_text().splitlines()]
    limited_s = next(one["fields"]["time_s"] for one in lines if one.get("event") == "BankLimitReported")
    plans = [one["fields"] for one in lines if one.get("event") == "UploadPlan"]
    least_m = airspeed_m_s**2 / (9.80665 * math.tan(math.radians(limit_deg)))
    wider = [one for one in plans if one["time_s"] > limited_s and one["plan"]["circle"]["radius_m"] >= least_m]
    assert wider[0]["time_s"] <= limited_s + 60.0
    rows = np.genfromtxt(truth, delimiter=",", names=True)
    since = rows[(rows["time_boot_s"] >= limited_s + 60.0) & (rows["uav_relative_alt_m"] > 60.0)]
    ranges_m = np.sqrt(np.maximum(since["slant_range_m"] ** 2 - since["uav_relative_alt_m"] ** 2, 0.0))
    in_band = float(np.mean((ranges_m >= 100.0) & (ranges_m <= 500.0)))
    off, uploads = flight.announced.count("left its line"), flight.end()["uploads"]
    print(f"{flavour}: in band {100.0 * in_band:.1f} %, least {ranges_m.min():.0f} m, {uploads} uploads, off {off}")
    assert in_band >= 0.99
    assert "another station has chosen" not in flight.announced

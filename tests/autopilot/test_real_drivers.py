"""ArduPlane's own payload drivers on simulated devices: what they report, next to the truth, and where they point.

SIDELONG_ARDUPLANE=/path/to/arduplane python -m pytest tests/autopilot/test_real_drivers.py

A serial port of the autopilot is the client of ``sidelong sitl --set device=...``, in real time.
"""

from __future__ import annotations

import csv
import math
import statistics
from collections import defaultdict

import numpy as np
import pytest
from pymavlink import DFReader, mavutil
from pymavlink.dialects.v20 import all as mavlink

from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, arduplane_with

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(900)]

# MNT1_TYPE, the serial port, and metres in a count of the logged range: ArduPlane takes SIYI's decimetres for metres.
DRIVERS = {"siyi": (8, "udpclient", 0.1), "viewpro": (11, "tcpclient", 1.0), "topotek": (12, "udpclient", 1.0)}
EXACT = (
    "range_sigma_m",
    "outlier_fraction",
    "gimbal_sigma_deg",
    "gimbal_yaw_bias_deg",
    "dropout_fraction",
    "latency_s",
)
GIMBAL, LASER_SWITCH, ON = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS, 177, 2
TAKEOFF_MODE, HIGH_M, WATCHED_S, BOOT_S = 13, 42.0, 25.0, 180.0
# In a turn of 16 degrees per second a report is late; whole percents of a rate leave 0.6 degrees.
YAW_OFF_DEG, PITCH_OFF_DEG, RANGE_OFF_M, POINTED_OFF_DEG = 6.0, 0.6, 5.0, 1.0


class Station:
    """A ground station of the vehicle, which asks for what it is to see ten times a second."""

    def __init__(self, url):
        self.link = mavutil.mavlink_connection(url.replace("tcpout://", "tcp:"), dialect="all", retries=30)
        self.boot_s = 0.0
        self.latest = {}

    def command(self, command, *params):
        padded = (*params, *(0.0,) * 7)[:7]
        self.link.mav.command_long_send(1, 1, command, 0, *padded)

    def ask(self):
        for message_id in (GIMBAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT):
            self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e5)

    def receive(self):
        """Return the next message; once a second of the vehicle's time it repeats what it asks for."""
        message = self.link.recv_match(blocking=True, timeout=30.0)
        assert message is not None, "the vehicle is silent"
        kind = message.get_type()
        self.latest[kind] = message
        now_s = getattr(message, "time_boot_ms", 0) / 1000.0
        if int(now_s) > int(self.boot_s):
            self.ask()
        self.boot_s = max(self.boot_s, now_s)
        return kind, message

    def until(self, holds, act=lambda: None, limit_s=BOOT_S):
        """Receive until something holds, and act once a second of the vehicle's time."""
        end_s, acted_s = self.boot_s + limit_s, -1
        self.ask()
        while not holds():
            if int(self.boot_s) > acted_s:
                acted_s = int(self.boot_s)
                act()
            self.receive()
            assert self.boot_s < end_s, {kind: str(one) for kind, one in self.latest.items()}

    @property
    def pointed_deg(self):
        """Yaw to the right of the nose and pitch, as the driver reports them."""
        if "GIMBAL_DEVICE_ATTITUDE_STATUS" not in self.latest:
            return math.nan, math.nan
        w, x, y, z = self.latest["GIMBAL_DEVICE_ATTITUDE_STATUS"].q
        yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return math.degrees(yaw_rad), math.degrees(math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))))


@pytest.fixture(params=DRIVERS)
def connected(request, tmp_path, free_port):
    """Return the driver, and what starts the autopilot with it on a device."""
    given = next((one.values[0] for one in FLAVOURS if one.values[0] == "arduplane"), None)
    if given is None or given.path is None:
        pytest.skip("SIDELONG_ARDUPLANE does not name a SITL program")
    mount_type, scheme, _ = DRIVERS[request.param]
    port = f"{scheme}:127.0.0.1:{free_port()}"
    parameters = (
        f"MNT1_TYPE {mount_type}\nSERIAL5_PROTOCOL 8\nSERIAL5_BAUD 115\nLOG_DISARMED 1\n"
        "MNT1_YAW_MIN -180\nMNT1_YAW_MAX 180\nMNT1_PITCH_MIN -90\nMNT1_PITCH_MAX 30\n"
    )
    program = arduplane_with(given.path, tmp_path / "arduplane", parameters, f"--serial5 {port}")
    exact = [word for key in EXACT for word in ("--set", f"payload.{key}=0")]

    def start(*options):
        device = "--set", f"device={request.param}@{port.partition(':')[2]}"
        return RealVehicle(program, "--target", "still", *device, *exact, *options)

    return request.param, start


def test_driver_reports_angles_and_range_of_the_target(connected, tmp_path):
    driver, start = connected
    truth, logs, seen = tmp_path / "truth.csv", tmp_path / "logs", defaultdict(list)
    with start("--truth", truth, "--set", f"logs={logs}") as vehicle:
        station = Station(vehicle.urls[0])

        def take_off():
            station.command(mavlink.MAV_CMD_DO_AUX_FUNCTION, LASER_SWITCH, ON)
            station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, TAKEOFF_MODE)
            station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

        station.until(
            lambda: (
                "GLOBAL_POSITION_INT" in station.latest
                and station.latest["GLOBAL_POSITION_INT"].relative_alt > 1000.0 * HIGH_M
            ),
            take_off,
            2.0 * BOOT_S,
        )
        begin_s = station.boot_s
        while station.boot_s < begin_s + WATCHED_S:
            kind, message = station.receive()
            if kind == "GIMBAL_DEVICE_ATTITUDE_STATUS":
                yaw_deg, pitch_deg = station.pointed_deg
                attitude = station.latest["ATTITUDE"]
                seen["time_s"].append(attitude.time_boot_ms / 1000.0)
                seen["bearing_deg"].append(math.degrees(attitude.yaw) + yaw_deg)
                seen["pitch_deg"].append(pitch_deg)
    rows = list(csv.DictReader(truth.open()))
    time_s, range_m, height_m = (
        np.array([float(row[key]) for row in rows]) for key in ("time_boot_s", "slant_range_m", "uav_relative_alt_m")
    )
    bearing_deg = np.degrees(np.unwrap(np.radians([float(row["bearing_deg"]) for row in rows])))
    true_deg = np.interp(seen["time_s"], time_s, bearing_deg)
    off_deg = np.remainder(seen["bearing_deg"] - true_deg + 180.0, 360.0) - 180.0
    elevation_deg = -np.degrees(np.arcsin(np.interp(seen["time_s"], time_s, height_m / range_m)))
    logged = DFReader.DFReader_binary(str(next(logs.rglob("*.BIN"))))
    ranges = []
    while (message := logged.recv_match(type="MNT")) is not None:
        at_s = message.TimeUS / 1e6
        if begin_s < at_s < begin_s + WATCHED_S and math.isfinite(message.Dist):
            ranges.append(message.Dist * DRIVERS[driver][2] - float(np.interp(at_s, time_s, range_m)))
    pitch_off_deg = np.array(seen["pitch_deg"]) - elevation_deg
    print(
        f"\n{driver}: yaw {np.median(off_deg):.2f}, pitch {np.median(pitch_off_deg):.2f} degrees, "
        f"range {statistics.median(ranges):.2f} m off in {len(off_deg)} and {len(ranges)} reports"
    )
    assert len(off_deg) > 5.0 * WATCHED_S
    assert len(ranges) > 5.0 * WATCHED_S
    assert np.median(np.abs(off_deg)) < YAW_OFF_DEG  # in a turn a report is late
    assert np.median(np.abs(pitch_off_deg)) < PITCH_OFF_DEG
    assert statistics.median(map(abs, ranges)) < RANGE_OFF_M


def test_driver_points_the_device_where_a_station_commands(connected):
    driver, start = connected
    with start("--set", "quirks.steered=true") as vehicle:
        station = Station(vehicle.urls[0])
        for pitch_deg, yaw_deg in ((-20.0, 30.0), (-45.0, -60.0)):
            goal_deg = np.array([yaw_deg, pitch_deg])
            command = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, pitch_deg, yaw_deg, math.nan, math.nan
            station.until(
                lambda goal_deg=goal_deg: np.abs(station.pointed_deg - goal_deg).max() < POINTED_OFF_DEG,
                lambda command=command: station.command(*command),
            )
            print(f"\n{driver}: commanded {yaw_deg:g}, {pitch_deg:g}, pointed {station.pointed_deg} degrees")

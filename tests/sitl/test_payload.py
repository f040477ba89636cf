"""Laser and gimbal against the truth, and in the form of the recorded logs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.payload import SimulatedPayload, TargetGeometry
from sidelong.sitl.settings import Flavour, GimbalFrame, PayloadSettings, RangeMessage

LOG_SIGHT = TargetGeometry(233.642, math.radians(-132.4020), -math.asin(120.03 / 233.642))


def measurements(settings, count, sight=LOG_SIGHT, heading_rad=0.0, seed=1):
    payload = SimulatedPayload(settings, np.random.SeedSequence(seed))
    return [payload.measure(0.1 * i, 100 * i, sight, heading_rad) for i in range(count)]


def of_kind(measured, kind):
    return [m for each in measured for m in each.messages if m.get_type() == kind]


def yaw_pitch_rad(message):
    w, x, y, z = message.q
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), math.asin(2 * (w * y - z * x))


def test_the_recorded_quaternion_comes_out():
    """The first gimbal message of the recorded ArduPlane flight, within its noise of 0.35 degrees and 0.4 bias."""
    quiet = PayloadSettings(gimbal_sigma_deg=0.0)
    q = np.array(of_kind(measurements(quiet, 1), "GIMBAL_DEVICE_ATTITUDE_STATUS")[0].q)
    recorded = np.array([0.3905392289, -0.2444421202, -0.1083713934, -0.8808988333])
    angle_rad = 2.0 * math.acos(min(1.0, abs(float(q @ recorded))))
    assert angle_rad < math.radians(2.0)


def test_a_gimbal_waits_at_its_stop_for_a_target_beyond_its_pan_limits():
    exact = PayloadSettings(gimbal_sigma_deg=0.0, gimbal_yaw_bias_deg=0.0, dropout_fraction=0.0)
    settings = replace(exact, pan_limit_deg=math.degrees(2.0))
    for pan_rad, yaw_rad in ((1.9, 1.9), (-1.9, -1.9), (2.1, 2.0), (-2.1, -2.0)):
        sight = TargetGeometry(300.0, 0.8 + pan_rad, -0.3)
        (measured,) = measurements(settings, 1, sight, heading_rad=0.8)
        (gimbal,) = of_kind([measured], "GIMBAL_DEVICE_ATTITUDE_STATUS")
        assert math.remainder(yaw_pitch_rad(gimbal)[0] - 0.8 - yaw_rad, math.tau) == pytest.approx(0.0, abs=1e-5)
        assert measured.laser_valid == (abs(pan_rad) < 2.0)


def test_noise_outliers_and_dropouts_have_the_stated_size():
    measured = measurements(PayloadSettings(), 20_000)
    ranges_m = np.array([m.current_distance / 100.0 for m in of_kind(measured, "DISTANCE_SENSOR")])
    wrong = np.abs(ranges_m - LOG_SIGHT.slant_range_m) > 6.0
    assert wrong.mean() == pytest.approx(0.02, abs=0.004)
    assert np.std(ranges_m[~wrong] - LOG_SIGHT.slant_range_m) == pytest.approx(0.8, abs=0.03)
    assert np.abs(ranges_m[wrong] - LOG_SIGHT.slant_range_m).min() > 14.0
    assert len(ranges_m) / len(measured) == pytest.approx(0.85, abs=0.05)
    angles = np.array([yaw_pitch_rad(m) for m in of_kind(measured, "GIMBAL_DEVICE_ATTITUDE_STATUS")])
    error_deg = np.degrees(angles - [LOG_SIGHT.bearing_rad, LOG_SIGHT.elevation_rad])
    assert error_deg.mean(axis=0) == pytest.approx([0.4, 0.0], abs=0.01)
    assert error_deg.std(axis=0) == pytest.approx([0.35, 0.35], abs=0.01)


def test_without_a_laser_there_is_no_range():
    measured = measurements(PayloadSettings(dropout_fraction=1.0), 1000)
    assert not of_kind(measured, "DISTANCE_SENSOR")
    assert len(of_kind(measured, "GIMBAL_DEVICE_ATTITUDE_STATUS")) == 1000


def test_dropouts_last_half_a_second_to_eight():
    valid = np.array([m.laser_valid for m in measurements(PayloadSettings(range_sigma_m=0.0), 20_000)])
    edges = np.flatnonzero(np.diff(np.concatenate(([True], valid, [True])).astype(int)))
    lengths_s = 0.1 * (edges[1::2] - edges[0::2])
    assert len(lengths_s) > 50
    assert 0.3 < lengths_s.min() < 1.0
    assert 7.0 < lengths_s.max() < 8.2


def test_an_outlier_admits_its_poor_quality():
    measured = measurements(PayloadSettings(outlier_fraction=0.3), 500)
    qualities = {(m.laser_outlier, m.messages[0].signal_quality) for m in measured if m.laser_valid}
    assert qualities == {(True, 35), (False, 90)}


@pytest.mark.parametrize(
    "change",
    [
        {"range_sigma_m": 5.0},
        {"outlier_fraction": 0.5},
        {"gimbal_sigma_deg": math.degrees(0.1), "gimbal_yaw_bias_deg": 0.0},
    ],
)
def test_a_change_of_one_noise_leaves_the_dropouts_alone(change):
    usual = [m.laser_valid for m in measurements(PayloadSettings(), 3000)]
    changed = [m.laser_valid for m in measurements(PayloadSettings(**change), 3000)]
    assert usual == changed


@pytest.mark.parametrize(("range_m", "received"), [(654.0, True), (660.0, False), (0.5, False)])
def test_the_laser_ends_where_its_message_ends(range_m, received):
    exact = PayloadSettings(range_sigma_m=0.0, outlier_fraction=0.0, dropout_fraction=0.0)
    measured = measurements(exact, 10, TargetGeometry(range_m, 0.0, 0.0))
    assert bool(of_kind(measured, "DISTANCE_SENSOR")) is received
    assert len(of_kind(measured, "GIMBAL_DEVICE_ATTITUDE_STATUS")) == 10


def test_a_vehicle_frame_gimbal_reports_yaw_from_the_nose():
    exact = PayloadSettings(gimbal_sigma_deg=0.0, gimbal_yaw_bias_deg=0.0, gimbal_frame=GimbalFrame.VEHICLE)
    message = of_kind(measurements(exact, 1, heading_rad=1.0), "GIMBAL_DEVICE_ATTITUDE_STATUS")[0]
    yaw_rad, pitch_rad = yaw_pitch_rad(message)
    assert math.remainder(yaw_rad - (LOG_SIGHT.bearing_rad - 1.0), math.tau) == pytest.approx(0.0, abs=1e-9)
    assert pitch_rad == pytest.approx(LOG_SIGHT.elevation_rad)
    assert message.flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
    assert not message.flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME


def test_the_other_range_message():
    settings = PayloadSettings(range_sigma_m=0.0, outlier_fraction=0.0, range_message=RangeMessage.RANGEFINDER)
    assert of_kind(measurements(settings, 1), "RANGEFINDER")[0].distance == LOG_SIGHT.slant_range_m


@pytest.mark.parametrize("flavour", list(Flavour))
def test_in_flight_the_messages_have_the_form_of_the_logs(simulate, station, flavour):
    ground = station(simulate(flavour=flavour))
    ground.run(30.0)
    heartbeat = ground.last("HEARTBEAT", 154)
    assert (heartbeat.type, heartbeat.autopilot) == (mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID)
    laser = ground.last("DISTANCE_SENSOR", 154)
    assert (laser.id, laser.orientation, laser.quaternion) == (1, 100, [1.0, 0.0, 0.0, 0.0])
    assert (laser.min_distance, laser.max_distance, laser.covariance) == (100, 65500, 255)
    gimbal = ground.last("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    assert gimbal.flags == 92
    assert math.isnan(gimbal.angular_velocity_x)
    assert len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS")) == pytest.approx(300, abs=2)


def test_a_measurement_is_stamped_when_it_is_made_and_comes_later(simulate, station):
    ground = station(simulate(payload=PayloadSettings(latency_s=0.2)))
    ground.run(10.0)
    newest_ms = ground.last("GIMBAL_DEVICE_ATTITUDE_STATUS").time_boot_ms
    assert newest_ms == pytest.approx(10_000 - 200, abs=101)


def test_the_measurement_belongs_to_the_position_of_its_stamp(simulate, station):
    exact = PayloadSettings(0.0, 0.0, 0.0, 0.0, 0.0, latency_s=0.3)
    ground = station(simulate(payload=exact))
    truth = {}
    ground.simulation.on_truth = lambda row: truth.update({round(row.time_s * 1000): row})
    ground.fly(ground.takeoff(80.0), ground.loiter(300.0, 300.0, 80.0, 80.0))
    ground.run(90.0)
    for laser in ground.all("DISTANCE_SENSOR")[-100:]:
        assert laser.current_distance / 100.0 == pytest.approx(truth[laser.time_boot_ms].slant_range_m, abs=0.006)
    for gimbal in ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS")[-100:]:
        yaw_rad, _ = yaw_pitch_rad(gimbal)
        error_rad = math.remainder(yaw_rad - truth[gimbal.time_boot_ms].bearing_rad, math.tau)
        assert abs(error_rad) < 1e-5


def test_px4_repeats_the_range_as_its_own_next_to_its_downward_sensor(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4))
    ground.run(30.0)
    own = ground.all("DISTANCE_SENSOR", 1)
    downward = [m for m in own if m.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270]
    repeated = [m for m in own if m.orientation == 100]
    assert len(downward) == pytest.approx(300, abs=2)
    assert {(m.id, m.covariance, m.signal_quality) for m in downward} == {(0, 0, 0)}
    lasers = {m.current_distance for m in ground.all("DISTANCE_SENSOR", 154)}
    assert repeated
    assert {m.current_distance for m in repeated} <= lasers
    assert {m.signal_quality for m in repeated} == {89, 34}


def test_arduplane_has_no_range_sensor_of_its_own(simulate, station):
    ground = station(simulate())
    ground.run(30.0)
    assert not ground.all("DISTANCE_SENSOR", 1)


def test_without_payload_component_154_is_silent(simulate, station):
    ground = station(simulate(payload=None))
    ground.run(10.0)
    assert not [m for m in ground.received if m.get_srcComponent() == 154]


def test_the_laser_can_fail_alone(simulate, station):
    ground = station(simulate())
    ground.run(5.0)
    ground.simulation.mute_payload("DISTANCE_SENSOR")
    ground.run(1.0)
    lasers, gimbals = len(ground.all("DISTANCE_SENSOR")), len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS"))
    ground.run(5.0)
    assert len(ground.all("DISTANCE_SENSOR")) == lasers
    assert len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS")) == gimbals + 50


def test_a_muted_payload_comes_back(simulate, station):
    ground = station(simulate())
    ground.run(5.0)
    ground.simulation.mute_payload()
    ground.run(1.0)
    before = len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS"))
    ground.run(10.0)
    assert len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS")) == before
    ground.simulation.muted.clear()
    ground.run(10.0)
    assert len(ground.all("GIMBAL_DEVICE_ATTITUDE_STATUS")) > before + 90

"""One flight written as tlog, ULog and DataFlash log, each after its format's published description."""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as dialect

# The flight: one tenth of a second a step, from 10 s after boot.
STEPS = 300
HOME_ALTITUDE_M, HEIGHT_M, RANGE_M = 488.0, 120.0, 250.0
SIGHT_WXYZ = (0.5, 0.5, -0.5, 0.5)
WIND_NORTH_M_S, WIND_EAST_M_S = 3.0, -1.0


def time_us(i: int) -> int:
    return 10_000_000 + 100_000 * i


def latitude_e7(i: int) -> int:
    return 473_977_418 + 100 * i


LONGITUDE_E7 = 85_455_940
ROLL_RAD, PITCH_RAD, YAW_RAD = 0.5, -0.1, 2.0
QUATERNION = (
    math.cos(ROLL_RAD / 2) * math.cos(PITCH_RAD / 2) * math.cos(YAW_RAD / 2)
    + math.sin(ROLL_RAD / 2) * math.sin(PITCH_RAD / 2) * math.sin(YAW_RAD / 2),
    math.sin(ROLL_RAD / 2) * math.cos(PITCH_RAD / 2) * math.cos(YAW_RAD / 2)
    - math.cos(ROLL_RAD / 2) * math.sin(PITCH_RAD / 2) * math.sin(YAW_RAD / 2),
    math.cos(ROLL_RAD / 2) * math.sin(PITCH_RAD / 2) * math.cos(YAW_RAD / 2)
    + math.sin(ROLL_RAD / 2) * math.cos(PITCH_RAD / 2) * math.sin(YAW_RAD / 2),
    math.cos(ROLL_RAD / 2) * math.cos(PITCH_RAD / 2) * math.sin(YAW_RAD / 2)
    - math.sin(ROLL_RAD / 2) * math.sin(PITCH_RAD / 2) * math.cos(YAW_RAD / 2),
)


def tlog_pieces(sender, stamped) -> list[bytes]:
    mav = sender()
    frames = []
    for i in range(STEPS):
        ms = time_us(i) // 1000
        frames += [
            mav.frame(dialect.MAVLink_attitude_message(ms, ROLL_RAD, PITCH_RAD, YAW_RAD, 0, 0, 0)),
            mav.frame(
                dialect.MAVLink_global_position_int_message(
                    ms,
                    latitude_e7(i),
                    LONGITUDE_E7,
                    round(1000 * (HOME_ALTITUDE_M + HEIGHT_M)),
                    round(1000 * HEIGHT_M),
                    1500,
                    -200,
                    50,
                    0,
                )
            ),
            mav.frame(
                dialect.MAVLink_distance_sensor_message(
                    ms, 0, 60_000, round(100 * RANGE_M), 0, 0, 100, 255, 0.0, 0.0, [0.0] * 4, 90
                )
            ),
            mav.frame(
                dialect.MAVLink_gimbal_device_attitude_status_message(
                    0, 0, ms, 4 | 8 | 16 | 64, SIGHT_WXYZ, 0.0, 0.0, 0.0, 0, gimbal_device_id=1
                )
            ),
            mav.frame(dialect.MAVLink_wind_cov_message(1000 * ms, WIND_NORTH_M_S, WIND_EAST_M_S, 0, 0, 0, 0, 0, 0)),
        ]
    return stamped(frames)


ULOG_TOPICS = {
    "home_position": ("uint64_t timestamp;double lat;double lon;float alt;", "<Qddf"),
    "vehicle_local_position": (
        "uint64_t timestamp;double ref_lat;double ref_lon;float ref_alt;float x;float y;float z;"
        "float vx;float vy;float vz;bool xy_global;bool z_global;uint8_t[2] _padding0;",
        "<Qddfffffff??",
    ),
    "vehicle_global_position": ("uint64_t timestamp;double lat;double lon;float alt;uint8_t[4] _padding0;", "<Qddf"),
    "vehicle_attitude": ("uint64_t timestamp;float[4] q;", "<Q4f"),
    "distance_sensor": (
        "uint64_t timestamp;float min_distance;float max_distance;float current_distance;float variance;"
        "int8_t signal_quality;uint8_t type;float[4] q;uint8_t orientation;",
        "<QffffbB4fB",
    ),
    "gimbal_device_attitude_status": (
        "uint64_t timestamp;uint16_t device_flags;float[4] q;uint8_t gimbal_device_id;",
        "<QH4fB",
    ),
    "wind": ("uint64_t timestamp;float windspeed_north;float windspeed_east;", "<Qff"),
    "sensor_combined": ("uint64_t timestamp;float[3] gyro_rad;", "<Q3f"),
}


def ulog_message(letter: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + letter + body


def ulog_pieces(steps: int = STEPS) -> list[bytes]:
    names = list(ULOG_TOPICS)
    pieces = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", time_us(0))]
    pieces += [ulog_message(b"F", f"{name}:{fields}".encode()) for name, (fields, _) in ULOG_TOPICS.items()]
    pieces += [ulog_message(b"A", struct.pack("<BH", 0, i) + name.encode()) for i, name in enumerate(names)]

    def data(name: str, *values: float) -> bytes:
        return ulog_message(b"D", struct.pack("<H", names.index(name)) + struct.pack(ULOG_TOPICS[name][1], *values))

    home = (latitude_e7(0) * 1e-7, LONGITUDE_E7 * 1e-7, HOME_ALTITUDE_M)
    pieces.append(data("home_position", time_us(0), *home))
    for i in range(steps):
        us = time_us(i)
        latitude_deg, longitude_deg = latitude_e7(i) * 1e-7, LONGITUDE_E7 * 1e-7
        pieces += [
            data("vehicle_attitude", us, *QUATERNION),
            data("sensor_combined", us, 0.1, 0.2, 0.3),
            data("vehicle_local_position", us, *home, 0.0, 0.0, -HEIGHT_M, 15.0, -2.0, 0.5, True, True),
            data("vehicle_global_position", us, latitude_deg, longitude_deg, HOME_ALTITUDE_M + HEIGHT_M),
            data("distance_sensor", us, 0.0, 600.0, RANGE_M, math.nan, 90, 0, 0.0, 0.0, 0.0, 0.0, 100),
            data("gimbal_device_attitude_status", us, 4 | 8 | 16 | 64, *SIGHT_WXYZ, 1),
            data("wind", us, WIND_NORTH_M_S, WIND_EAST_M_S),
        ]
        if i % 100 == 50:
            pieces.append(ulog_message(b"S", bytes.fromhex("2f7313 20250cbb12")))
    return pieces


DATAFLASH_KINDS = {
    "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns", "<BB4s16s64s"),
    "GPS": (1, "QBIHff f".replace(" ", ""), "TimeUS,Status,GMS,GWk,Spd,GCrs,VZ", "<QBIHfff"),
    "XKF1": (2, "QBfff", "TimeUS,C,VN,VE,VD", "<QBfff"),
    "POS": (3, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "<Qiifff"),
    "ATT": (4, "QccC", "TimeUS,Roll,Pitch,Yaw", "<QhhH"),
    "RFND": (5, "QBCBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality", "<QBHBBb"),
    "MNT": (6, "QBfff", "TimeUS,I,Roll,Pitch,YawE", "<QBfff"),
    "XKF2": (7, "QBff", "TimeUS,C,VWN,VWE", "<QBff"),
    "IMU": (8, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "<QBffffff"),
}


def dataflash_entry(name: str, *values: float | bytes) -> bytes:
    number, _, _, code = DATAFLASH_KINDS[name]
    return b"\xa3\x95" + bytes([number]) + struct.pack(code, *values)


def dataflash_pieces(steps: int = STEPS) -> list[bytes]:
    pieces = [
        dataflash_entry("FMT", number, 3 + struct.calcsize(code), name.encode(), letters.encode(), fields.encode())
        for name, (number, letters, fields, code) in DATAFLASH_KINDS.items()
    ]
    yaw_deg, pitch_deg, roll_deg = 90.0, 0.0, 90.0  # SIGHT_WXYZ is found again from these below
    for i in range(steps):
        us = time_us(i)
        altitudes = (HOME_ALTITUDE_M + HEIGHT_M, HEIGHT_M, HEIGHT_M)
        angles = (math.degrees(ROLL_RAD), math.degrees(PITCH_RAD), math.degrees(YAW_RAD))
        pieces += [
            dataflash_entry("ATT", us, *(round(100 * angle) for angle in angles)),
            dataflash_entry("IMU", us, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8),
            dataflash_entry("XKF1", us, 0, 15.0, -2.0, 0.5),
            dataflash_entry("XKF1", us, 1, 99.0, 99.0, 99.0),
            dataflash_entry("POS", us, latitude_e7(i), LONGITUDE_E7, *altitudes),
            dataflash_entry("RFND", us, 0, round(100 * RANGE_M), 4, 100, 90),
            dataflash_entry("MNT", us, 0, roll_deg, pitch_deg, yaw_deg),
            dataflash_entry("XKF2", us, 0, WIND_NORTH_M_S, WIND_EAST_M_S),
        ]
    return pieces

"""Your own SITL program with a camera alone: an operator at a station clicks the target in the rendered picture.

    export SIDELONG_ARDUPLANE=PATH SIDELONG_PX4=PATH SIDELONG_TARGETS=FOLDER
    python -m pytest tests/autopilot/test_real_camera.py -s

The first of the targets is flown next to, or TARGET=NAME, for CAMERA_S seconds at the clock's speed, since pictures
have no faster one. The autopilot's gimbal manager turns the gimbal. The flight is compared with the study of a laser
next to the piece of track that it watched. RECORDS=FOLDER keeps the records.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import threading
import time
from collections import Counter, deque
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.analysis.truth import read_truth
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.flight.shell import free_udp_port
from sidelong.app.records.journal import JournalReader
from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, configured
from tests.bench.test_real_flights import (
    SIDE_MAX,
    TARGET_SPEED_MAX_M_S,
    TARGETS,
    flown,
    judged_as_studied,
    piece_of,
    seen,
    simulated,
    studied,
    write_played,
)

TARGET = [one for one in TARGETS if one.stem == os.environ.get("TARGET", one.stem)][:1]
DURATION_S, VIEW_DEG = float(os.environ.get("CAMERA_S", "1200")), 12.0
_ABOVE_M, _WITHIN_M, _BY_HAND_S, _AGAIN_S = 60.0, 400.0, 5.0, 20.0
_OFF_AXIS_DEG = 4.0  # between axis and target: another object is followed
_DOWN_DEG = VIEW_DEG * 9.0 / 16.0
_CAMERA = mavlink.MAV_COMP_ID_CAMERA
_STOPPED, _FOLLOWED = 0, 1  # tracking status


class Operator(threading.Thread):
    """A ground station that points the gimbal at the target until the tracker follows it, and again after a loss.

    Attributes:
        off_deg: of each attitude of the gimbal: vehicle's time s, target to the right of and above its axis, degrees.
        results: how often each command to the camera had each result.
        seen: names of the camera's messages.
        clicks: how often a point or rectangle was given.
    """

    def __init__(self, url: str, truth: Path) -> None:
        super().__init__(daemon=True)
        os.environ["MAVLINK20"] = "1"
        self._address, self._link = url.replace("tcpout://", "tcp:").replace("udpin://", "udpin:"), cast(Any, None)
        self._truth_file, self._line = truth, ""
        self._truth: dict[int, list[float]] = {}
        self._place: Any = None
        self._late: deque[Any] = deque(maxlen=100)
        self._sent_s, self._on_target_s, self._by_hand_s = 0.0, math.inf, math.inf
        self._status, self._zoom_deg = _STOPPED, list[float]()
        self.off_deg: list[tuple[float, float, float]] = []
        self.results: Counter[tuple[int, int]] = Counter()
        self.seen: set[str] = set()
        self.clicks = 0
        self.ended = threading.Event()

    def run(self) -> None:
        while self._link is None and not self.ended.wait(1.0):
            with contextlib.suppress(ConnectionError):  # ArduPlane opens the port once its first one is connected
                self._link = mavutil.mavlink_connection(self._address, 57600, 255, 190, retries=1, dialect="all")
        rows = self._truth_file.open()
        while not self.ended.is_set():
            for line in rows.read().splitlines(keepends=True):
                self._line += line
                if line.endswith("\n"):
                    self._add(self._line)
                    self._line = ""
            message = self._link.recv_match(blocking=True, timeout=0.2)
            if message is not None and message.get_type() != "BAD_DATA":
                self._take(message)
            if time.monotonic() > self._sent_s + 0.5:
                self._sent_s = time.monotonic()
                self._work(self._sent_s)
        self._link.close()

    def _add(self, line: str) -> None:
        values = line.split(",")
        if values[0] != "time_boot_s":
            self._truth[round(1000.0 * float(values[0]))] = [float(value) for value in values[1:10]] + [
                float(values[12])
            ]

    def _take(self, message: Any) -> None:
        kind, component = message.get_type(), message.get_srcComponent()
        if component == _CAMERA:
            self.seen.add(kind)
        if kind == "GLOBAL_POSITION_INT" and component == 1:
            self._place = message
        elif kind == "COMMAND_ACK" and component == _CAMERA:
            self.results[message.command, message.result] += 1
        elif kind == "CAMERA_TRACKING_IMAGE_STATUS":
            self._status = message.tracking_status
        elif kind == "CAMERA_FOV_STATUS":
            self._zoom_deg.append(message.hfov)
        elif kind == "GIMBAL_DEVICE_ATTITUDE_STATUS" and component == mavlink.MAV_COMP_ID_GIMBAL:
            self._compare(message)

    def _compare(self, gimbal: Any) -> None:
        """Compare the axis with the true line of the same moment, once that is written."""
        self._late.append(gimbal)
        while self._late and (row := self._truth.get(self._late[0].time_boot_ms)) is not None:
            one = self._late.popleft()
            w, x, y, z = one.q
            yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z))))
            right_deg = math.remainder(row[8] - math.degrees(yaw), 360.0)
            up_deg = math.degrees(-math.asin(min(1.0, (row[6] - row[9]) / row[7])) - pitch)
            self.off_deg.append((one.time_boot_ms / 1000.0, right_deg, up_deg))
            if self._status == _FOLLOWED and max(abs(right_deg), abs(up_deg)) < _OFF_AXIS_DEG:
                self._on_target_s = time.monotonic()

    def _work(self, now_s: float) -> None:
        mav = self._link.mav
        mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        self._command(1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5e5)
        if not self._truth or self._place is None or "HEARTBEAT" not in self.seen:
            return
        if self.clicks == 0 or "CAMERA_INFORMATION" not in self.seen:
            self._command(_CAMERA, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION)
            self._command(
                _CAMERA,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS,
                2e5,
            )
        row = self._truth[max(self._truth)]
        if self._by_hand_s == math.inf:  # the tracker leads, or nothing is to be seen yet
            follows = self.clicks > 0 and now_s < self._on_target_s + _AGAIN_S
            if follows or row[6] < _ABOVE_M or row[7] > _WITHIN_M:
                return
            self._command(_CAMERA, mavlink.MAV_CMD_CAMERA_STOP_TRACKING)
            self._by_hand_s = now_s
        place = (
            round(row[2] * 1e7),
            round(row[3] * 1e7),
            (self._place.alt - self._place.relative_alt) / 1000.0 + row[9],
        )
        roi = mavlink.MAV_CMD_DO_SET_ROI_LOCATION
        mav.command_int_send(1, 1, mavlink.MAV_FRAME_GLOBAL, roi, 0, 0, 0, 0, 0, 0, *place)
        if now_s > self._by_hand_s + _BY_HAND_S:
            self.clicks, self._by_hand_s, self._on_target_s = self.clicks + 1, math.inf, now_s
            x, y = (
                0.5 + off_deg / view_deg
                for off_deg, view_deg in zip(self._aim_deg(), (VIEW_DEG, _DOWN_DEG), strict=True)
            )
            if self.clicks % 2:
                self._command(_CAMERA, mavlink.MAV_CMD_CAMERA_TRACK_POINT, x, y)
            else:
                edges = x - 0.02, y - 0.03, x + 0.02, y + 0.03
                self._command(_CAMERA, mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE, *edges)

    def _aim_deg(self) -> tuple[float, float]:
        """Return where the target is seen, to the right and below the middle: the gimbal is led behind it."""
        _, right_deg, up_deg = self.off_deg[-1]
        return right_deg, -up_deg

    def _command(self, component: int, command: int, *params: float) -> None:
        self._link.mav.command_long_send(1, component, command, 0, *params, *(0.0,) * (7 - len(params)))


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("target", TARGET, ids=lambda path: path.stem)
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_flight_by_a_camera_alone_is_as_the_study_of_a_laser_predicts(flavour, target, tmp_path):
    truth, video = tmp_path / "truth.csv", f"udp://127.0.0.1:{free_udp_port()}"
    options = [*simulated(flavour, tmp_path / "target.csv", truth), "--speed", 1.0]
    options += ["--set", f"camera.url={video}", "--set", f"camera.view_deg={VIEW_DEG}"]
    write_played(flavour, target, tmp_path / "target.csv")
    camera = f'[camera]\nsource = "{video}"\nview_deg = {VIEW_DEG}\n[terrain]\nflat = true\n'
    limit = f"[requirement]\ntarget_speed_max_m_s = {TARGET_SPEED_MAX_M_S[flavour]}\n"
    configured(tmp_path / "mission.toml", flavour, limit + camera)
    vehicle, operators = RealVehicle(flavour, *options), []

    class Operated:
        """The vehicle with its operator, who comes once it is up."""

        urls: list[str]

        def __enter__(self):
            vehicle.__enter__()
            self.urls = vehicle.urls
            operators.append(Operator(self.urls[1], truth))
            operators[0].start()

        def __exit__(self, *raised):
            operators[0].ended.set()
            operators[0].join()
            vehicle.__exit__(*raised)

    try:
        run = flown(Operated(), "mission", tmp_path, DURATION_S, known=False)
    finally:
        if "RECORDS" in os.environ:
            shutil.copytree(tmp_path, Path(os.environ["RECORDS"]) / f"camera-{flavour}-{target.stem}")
    operator = operators[0]
    log, changed_s = seen(read_truth(truth), JournalReader(run / "journal.jsonl", JOURNAL_TYPES), DURATION_S)
    watched = judged_as_studied(log, changed_s, piece_of(log, target, tmp_path))
    study = studied(flavour, tmp_path, known=False)
    off = np.abs([one[1:] for one in operator.off_deg if one[0] >= log[0, 0]]) / (np.array([VIEW_DEG, _DOWN_DEG]))
    picture, middle = (100.0 * np.mean(off.max(axis=1) < share) for share in (0.5, 0.25))
    print(
        f"\n{flavour} {target.stem}\n  flown   {watched}\n  studied {study}\n  in the picture {picture:.1f} %", end=""
    )
    print(f", in its middle half {middle:.1f} %, clicks {operator.clicks}, {sorted(operator.seen)}")
    assert not [result for result in operator.results if result[1] != mavlink.MAV_RESULT_ACCEPTED]
    assert watched.side >= study.side - SIDE_MAX
    assert watched.band >= 0.995
    assert watched.min_range_m >= 95.0
    assert picture >= 98.0
    assert middle >= 95.0

"""The stream for other systems: H.264 with metadata, checked by programs that did not write it."""

from __future__ import annotations

import io
import math
import socket
from datetime import UTC, datetime

import av
import klvdata
import numpy as np
import pytest
from klvdata.misb0601 import UASLocalMetadataSet
from stanag4609 import FMVVerifier
from stanag4609.verifier import VerificationStatus

from sidelong.app.camera.video import VideoOutput
from sidelong.app.records.klv import Marked, Sensor, UasMetadata
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading

PLANE, BOOTED = LocalPlane(47.4, 8.5), datetime(2026, 11, 21, 9, 0, 0, tzinfo=UTC)
WIDTH, HEIGHT, RATE_HZ, PICTURES = 320, 180, 15.0, 45
_KEY = bytes.fromhex("060e2b34")
DOWN_RAD = math.radians(30.0)


def send(output: VideoOutput, size_px=lambda _k: (WIDTH, HEIGHT), pictures=PICTURES, name="a flight") -> None:
    """Send pictures of an aircraft that looks south at a box in the middle."""
    metadata = UasMetadata(name, PLANE, BOOTED, 488.0, (math.radians(20.0), math.radians(11.3)))
    rng = np.random.default_rng(3)
    for k in range(pictures):
        time_s = 100.0 + k / RATE_HZ
        width, height = size_px(k)
        picture = rng.integers(60, 120, (height, width, 3), np.uint8)
        klv = metadata.packet(
            time_s,
            PositionReading(time_s, 0.0, 0.0, 120.0, 10.0, 0.0, 0.0),
            AttitudeReading(time_s, math.radians(20.0), 0.0, math.pi / 2),
            Sensor(from_roll_pitch_yaw(0.0, -DOWN_RAD, math.pi), 0.0),
            None,
            Marked((WIDTH, HEIGHT), (150.0, 80.0, 170.0, 100.0), 0.9),
        )
        output.put(picture, time_s, metadata.stamp_us(time_s), klv)
    output.close()


@pytest.fixture(scope="module")
def stream() -> bytes:
    """Return what arrives at a network address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        receiver.setblocking(False)
        output, received = VideoOutput(RATE_HZ, None, address=receiver.getsockname()), io.BytesIO()
        write = output._write

        def written(packets: list[bytes]) -> None:
            write(packets)
            while True:
                try:
                    received.write(receiver.recv(2048))
                except BlockingIOError:
                    return

        output._write = written
        send(output)
    return received.getvalue()


def test_a_verifier_of_the_standards_finds_no_error(stream):
    verifier = FMVVerifier()
    verifier.feed(stream)
    report = verifier.finish()
    assert [(one.code, one.message) for one in report.findings if one.status is VerificationStatus.ERROR] == []
    assert {"st0604.timestamp.syntax", "st0902.profile", "st0903.vmti"} <= {one.code for one in report.findings}


def test_metadata_of_three_packets_fits_the_buffer_of_a_decoder(tmp_path):
    verifier, name = FMVVerifier(), "long-name-" * 11
    send(VideoOutput(RATE_HZ, tmp_path / "a.ts"), lambda _k: (1280, 720), 5, name)
    verifier.feed((tmp_path / "a.ts").read_bytes())
    report = verifier.finish()
    assert [one.message for one in report.findings if one.status is VerificationStatus.ERROR] == []
    assert any(one.code == "st0902.profile" for one in report.findings)


def test_the_clock_is_sent_each_tenth_of_a_second_also_between_pictures(tmp_path):
    output, verifier = VideoOutput(RATE_HZ, tmp_path / "a.ts"), FMVVerifier()
    for time_s in (25.0, 25.07, 25.3, 27.0, 27.07):
        output.put(np.zeros((HEIGHT, WIDTH, 3), np.uint8), time_s)
    output.close()
    verifier.feed((tmp_path / "a.ts").read_bytes())
    errors = [one for one in verifier.finish().findings if one.status is VerificationStatus.ERROR]
    assert "st1402.pcr.interval" not in {one.code for one in errors}


def test_another_decoder_gets_all_pictures_at_their_times(stream):
    with av.open(io.BytesIO(stream)) as container:
        times_s = [float(frame.time) for frame in container.decode(video=0)]
    assert len(times_s) == PICTURES
    assert times_s[0] == pytest.approx(100.0, abs=1e-4)
    assert np.diff(times_s) == pytest.approx(1.0 / RATE_HZ, abs=1e-4)


def test_another_reader_gets_the_metadata_of_each_picture(stream, monkeypatch):
    monkeypatch.delitem(UASLocalMetadataSet.parsers, b"\x4a")  # klvdata 0.0.3 fails on its own class for ST 0903
    with av.open(io.BytesIO(stream)) as container:
        units = [bytes(packet) for packet in container.demux(container.streams.data[0])]
    data = b"".join(unit[unit.index(_KEY) :] for unit in units if unit)
    packets = list(klvdata.StreamParser(data))
    found = [{tag: value for tag, (*_, value) in packet.MetadataList().items()} for packet in packets]
    assert len(found) == PICTURES
    last = found[-1]
    assert datetime.fromisoformat(last[2]).timestamp() == pytest.approx(BOOTED.timestamp() + 100.0, abs=4.0)
    assert PLANE.east_north_m(float(last[23]), float(last[24])) == pytest.approx((0.0, -207.8), abs=1.0)
    assert float(last[21]) == pytest.approx(240.0, abs=0.1)
    assert (float(last[43]), float(last[44])) == pytest.approx((20.0, 20.0), abs=1.0)

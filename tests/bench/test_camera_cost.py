"""The CPU time that a camera takes (decoding, tracking, recording with metadata, the page's picture), and its memory.

``python -m pytest tests/bench/test_camera_cost.py -s``. CPU time of the process, so that other load does not count.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

import av
import pytest

from tests.bench.size import size
from tests.camera.test_runner import RATE_HZ, run

PICTURES = size(300, 20, "CAMERA_PICTURES")
LAUNCH_S, MEMORY_MAX_MIB = size(120, 20, "CAMERA_LAUNCH_S"), 350.0


def test_a_camera_leaves_most_of_a_core_to_the_flight(tmp_path):
    _, _, record, spent_s, _ = run(tmp_path / "video.ts", PICTURES, 1.0)
    begun_s = time.process_time()
    with av.open(str(record)) as container:
        decoded = [frame.to_ndarray(format="bgr24").shape for frame in container.decode(video=0)]
    decoding_s = (time.process_time() - begun_s) / len(decoded)
    share = RATE_HZ * (spent_s + decoding_s)
    print(f"\n{1e3 * spent_s:.1f} ms a picture and {1e3 * decoding_s:.1f} ms to decode it: {share:.0%} of a core")
    assert len(decoded) == PICTURES
    assert share < 0.6


@pytest.mark.timeout(900)
def test_a_launch_with_a_camera_fits_into_its_memory(tmp_path):
    launch = [sys.executable, "-m", "sidelong", "launch", "--payload", "video://", "--duration", str(LAUNCH_S)]
    launch += [
        "--out",
        str(tmp_path),
        "--view",
        "--set",
        "display.port=0",
        "--set",
        "camera.stream=udp://127.0.0.1:9",
    ]
    subprocess.run([sys.executable, "-m", "sidelong", "prepare"], check=True)  # a compiler takes more
    with subprocess.Popen(launch, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    print(f"\nat most {used.ru_maxrss / 1024:.0f} MiB")
    assert process.returncode == 0
    assert "the camera follows the object" in printed
    assert used.ru_maxrss / 1024 <= MEMORY_MAX_MIB

"""The CPU time that a camera takes: decoding, tracking, recording with metadata, and the page's picture.

``python -m pytest tests/bench/test_camera_cost.py -s``. CPU time of the process, so that other load does not count.
"""

from __future__ import annotations

import time

import av

from tests.bench.size import size
from tests.camera.test_runner import RATE_HZ, run

PICTURES = size(300, 20, "CAMERA_PICTURES")


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

"""Video from files and streams, whole and damaged."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from sidelong.app.camera.video import VideoOutput, VideoReplay, VideoSource, checked_source
from sidelong.app.errors import InputError


def written(path, pictures=60, size=(320, 180), budget=float("inf")):
    video, rng = VideoOutput(15.0, path, budget), np.random.default_rng(2)
    for k in range(pictures):
        picture = rng.integers(60, 120, (size[1], size[0], 3), np.uint8)
        picture[60:120, 4 * k : 4 * k + 40] = (30, 30, 200)
        video.put(picture, k / 15.0)
    video.close()
    return path


def pictures_of(path, reports):
    source, found = VideoSource(str(path), reports.append, paced=False), []
    while (taken := source.next(2.0)) is not None or not source.ended:
        if taken is not None:
            found.append(taken[0])
    source.close()
    return source, found


def test_what_is_written_is_decoded_again(tmp_path):
    source, found = pictures_of(written(tmp_path / "a.ts"), [])
    assert len(found) + source.dropped == 60
    assert found[-1].shape == (180, 320, 3)
    assert found[-1][90, 256, 2] > 150


@pytest.mark.parametrize("damage", ["cut", "noise"])
def test_a_damaged_video_gives_the_pictures_that_are_whole(tmp_path, damage):
    data = bytearray(written(tmp_path / "a.ts").read_bytes())
    rng = np.random.default_rng(1)
    if damage == "cut":
        del data[len(data) // 3 : len(data) // 3 + 5000]
    else:
        for at in rng.integers(len(data) // 4, len(data), 60):
            data[at] ^= 0xFF
    (tmp_path / "b.ts").write_bytes(data)
    source, found = pictures_of(tmp_path / "b.ts", [])
    assert len(found) + source.dropped > 15


def test_a_recording_ends_at_its_budget(tmp_path):
    whole = written(tmp_path / "a.ts").stat().st_size
    assert written(tmp_path / "b.ts", budget=whole / 4).stat().st_size < 0.6 * whole


def test_a_recording_is_played_again_by_the_times_of_its_pictures(tmp_path):
    path = written(tmp_path / "video.ts", pictures=120)
    times_s = [k / 15.0 for k in range(120)]
    path.with_suffix(".jsonl").write_text("".join(f'{{"time_s":{time_s:.3f}}}\n' for time_s in times_s))
    replay = VideoReplay(path)
    assert replay.shown(-1.0) is None
    for wanted_s in (0.5, 0.9, 5.0, 1.0, 7.9):  # forwards, ahead, back
        marks, jpeg = replay.shown(wanted_s).split(b"\n", 1)
        k = int(wanted_s * 15.0 + 1e-6)
        assert json.loads(marks)["time_s"] == pytest.approx(times_s[k], abs=1e-3)
        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        red = np.flatnonzero(picture[90, :, 2] > 150)
        assert red.size == 0 if k > 79 else red[0] == pytest.approx(4 * k, abs=3)


def test_a_source_that_does_not_exist_is_refused_in_words():
    with pytest.raises(InputError, match="give rtsp://"):
        checked_source("nowhere.mp4")

"""Damaged videos: cut, with bit errors, of changed resolution, silent, and of a camera that restarts.

VIDEO_DAMAGES: videos with cuts or bit errors, 20 unless given; for each ten of them the resolution changes once, and
a camera restarts twice.
"""

from __future__ import annotations

import itertools
import os
import socket

import numpy as np
import pytest

from sidelong.app.camera.video import Picture, VideoOutput, VideoSource

DAMAGES = int(os.environ.get("VIDEO_DAMAGES", "20"))
_FEW = max(DAMAGES // 10, 1)
RATE_HZ, PICTURES, RESUMED_WITHIN_S = 15.0, 150, 3.0
_BITS = 8


def picture_of(number: int, size_px: tuple[int, int]) -> Picture:
    """Return a picture whose columns are the bits of a number."""
    width, height = size_px
    bright = np.repeat([200 if number >> bit & 1 else 50 for bit in range(_BITS)], width // _BITS)
    noise = np.random.default_rng(number).integers(0, 30, (height, width, 3), np.uint8)
    return (np.broadcast_to(bright[None, :, None], noise.shape) + noise).astype(np.uint8)


def number_of(picture: Picture) -> int:
    height, width, _ = picture.shape
    middles = [round(width * (bit + 0.5) / _BITS) for bit in range(_BITS)]
    inner = picture[height // 4 : 3 * height // 4]
    return sum(int(inner[:, at - 3 : at + 4].mean() > 140.0) << bit for bit, at in enumerate(middles))


class Watched(VideoSource):
    """Stores the numbers of all its pictures, also of those that replace others."""

    def __init__(self, source: str) -> None:
        self.numbers: list[int] = []
        self.reports: list[str] = []
        super().__init__(source, self.reports.append, paced=False)

    def _put(self, picture: Picture) -> None:
        self.numbers.append(number_of(picture))
        super()._put(picture)

    def read(self) -> None:
        """Wait for its end."""
        while not self.ended:
            self.next(10.0)
        self.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    """Return a video of 10 s."""
    return filmed(tmp_path_factory.mktemp("video") / "whole.ts", range(PICTURES), (160, 96))


def filmed(path, numbers, size_px) -> bytes:
    output = VideoOutput(RATE_HZ, path)
    for number in numbers:
        output.put(picture_of(number, size_px), 100.0 + number / RATE_HZ)
    output.close()
    return path.read_bytes()


def test_pictures_come_again_within_three_seconds_after_damage(tmp_path, whole):
    rng, unreported, path = np.random.default_rng(5), 0, tmp_path / "damaged.ts"
    for case in range(DAMAGES):
        data, begin = bytearray(whole), int(rng.integers(len(whole) // 10, len(whole) // 2))
        end = begin + int(rng.integers(1, len(whole) // 10))
        if case % 2:
            del data[begin:end]
        else:
            for at in rng.integers(begin, end, int(rng.integers(1, 40))):
                data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        source = Watched(str(path))
        source.read()
        first = PICTURES * end / len(whole) + RESUMED_WITHIN_S * RATE_HZ
        missing = set(range(int(np.ceil(first)), PICTURES)) - set(source.numbers)
        assert not missing, f"case {case}: bytes {begin} to {end}"
        lost = PICTURES - len(set(source.numbers))
        unreported += lost > 1 and not source.reports
    assert unreported == 0


def test_a_change_of_resolution_is_followed(tmp_path, whole):
    rng = np.random.default_rng(6)
    for case in range(_FEW):
        size_px = int(rng.integers(10, 40)) * 16, int(rng.integers(6, 23)) * 16
        later = filmed(tmp_path / "later.ts", range(PICTURES, PICTURES + 60), size_px)
        (tmp_path / "both.ts").write_bytes(whole[: int(rng.integers(len(whole) // 2, len(whole)))] + later)
        source = Watched(str(tmp_path / "both.ts"))
        source.read()
        assert set(range(PICTURES, PICTURES + 60)) - set(source.numbers) == set(), f"case {case}: {size_px}"


def test_silence_and_a_restart_of_the_camera_are_reported_and_survived():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    source, rng, longest = Watched(f"udp://127.0.0.1:{address[1]}"), np.random.default_rng(7), 0

    def words(text: str) -> int:
        return sum(text in report for report in source.reports)

    size_px = 160, 96
    for _ in range(2 * _FEW):  # each camera counts from 0 again, with pictures of another size
        size_px = 480 - size_px[0], 272 - size_px[1]
        before, seen = words("no picture"), None
        output, begin = VideoOutput(RATE_HZ, None, address=address), int(rng.integers(256))
        for sent in itertools.count(1):
            output.put(picture_of((begin + sent) % 256, size_px), (begin + sent) / RATE_HZ)
            taken = source.next(1.0 / RATE_HZ)
            seen = seen if taken is None else taken[0].shape[1::-1]
            if seen == size_px:
                break
        longest = max(longest, sent)
        output.close()
        assert words("pictures again") == words("no picture")
        while words("no picture") == before:
            source.next(1.0)
    source.close()
    print(f"\n{2 * _FEW} restarts, pictures again after at most {longest / RATE_HZ:.1f} s of the stream")
    assert longest <= RESUMED_WITHIN_S * RATE_HZ
    assert words("no picture") >= 2 * _FEW

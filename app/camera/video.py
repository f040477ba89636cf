"""Video in and out, by PyAV: sources of any kind in a thread of their own, and MPEG-TS with H.264 and KLV."""

from __future__ import annotations

import contextlib
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt

from sidelong.app.errors import InputError

Picture = npt.NDArray[np.uint8]

_FORMS = "rtsp://HOST/PATH, udp://HOST:PORT, /dev/videoN or a video file"
_OPEN_S, _READ_S, _RETRY_S = 5.0, 1.5, 0.5
_WIDTH_MAX_PX = 1280
_STREAMS = re.compile(r"(rtsps?|udp|tcp|srt|https?)://\S+")


def checked_source(source: str) -> str:
    """Return the source. Raises InputError for one that cannot be a video."""
    if _STREAMS.fullmatch(source) or Path(source).exists():
        return source
    raise InputError(f"the video source {source!r:.80} does not exist; give {_FORMS}.")


class VideoSource:
    """Decodes a source until it is closed; opens it again when it ends or is damaged.

    A picture that comes while the last one is still being worked on replaces it: nothing is queued.

    Args:
        source: As :func:`checked_source` takes it.
        report: Receives loss and return in words, from another thread.
        paced: Whether a file is played at its own speed.
    """

    def __init__(self, source: str, report: Callable[[str], object], *, paced: bool = True) -> None:
        self._source, self._report = checked_source(source), report
        self._is_file = Path(source).is_file()
        self._paced = paced and self._is_file
        self._closing = threading.Event()
        self._changed = threading.Condition()
        self._latest: tuple[Picture, float] | None = None
        self.dropped = self.damaged = 0
        self.ended = False
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    def next(self, timeout_s: float) -> tuple[Picture, float] | None:
        """Return the next picture (BGR) and when it arrived, on the monotonic clock; None: none has come."""
        with self._changed:
            self._changed.wait_for(lambda: self._latest is not None or self.ended, timeout_s)
            latest, self._latest = self._latest, None
            return latest

    def close(self) -> None:
        """End it."""
        self._closing.set()
        self._thread.join(_READ_S + 1.0)

    def _run(self) -> None:
        silent = False
        while not self._closing.is_set():
            why = "it has ended"
            try:
                for picture in self._decoded():
                    if silent:
                        silent = False
                        self._report(f"video {self._source}: pictures again")
                    self._put(picture)
                    if self._closing.is_set():
                        return
            except (av.FFmpegError, OSError, ValueError) as error:
                why = getattr(error, "strerror", None) or str(error) or type(error).__name__
            if self._is_file:
                break
            if not silent:
                silent = True
                self._report(f"video {self._source}: no picture ({why}); trying again each {_RETRY_S:g} s")
            self._closing.wait(_RETRY_S)
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def _put(self, picture: Picture) -> None:
        with self._changed:
            self.dropped += self._latest is not None
            self._latest = picture, time.monotonic()
            self._changed.notify_all()

    def _decoded(self) -> Iterator[Picture]:
        options = {"fflags": "nobuffer", "flags": "low_delay", "rtsp_transport": "tcp"}
        url = self._source
        if url.startswith("udp:"):
            url += ("&" if "?" in url else "?") + "overrun_nonfatal=1&fifo_size=50000"
            options |= {"probesize": "65536", "analyzeduration": "200000"}
        kind = "v4l2" if url.startswith("/dev/") else None
        with av.open(url, format=kind, options=options, timeout=(_OPEN_S, _READ_S)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"  # threads by picture would each delay it
            begun_s = first_s = math.nan
            for packet in container.demux(stream):
                try:
                    frames = packet.decode()
                except av.FFmpegError:
                    self.damaged += 1
                    continue
                for frame in frames:
                    if self._paced and frame.time is not None:
                        if math.isnan(first_s):
                            first_s, begun_s = frame.time, time.monotonic()
                        self._closing.wait(max(0.0, begun_s + frame.time - first_s - time.monotonic()))
                    width = min(frame.width, _WIDTH_MAX_PX)
                    height = round(frame.height * width / frame.width / 2) * 2
                    yield np.asarray(frame.to_ndarray(format="bgr24", width=width, height=height), np.uint8)


class VideoFile:
    """Writes pictures as MPEG-TS with H.264, within a budget of bytes: to a file, or to udp://HOST:PORT."""

    def __init__(self, target: str, rate_hz: float, budget_bytes: float = float("inf")) -> None:
        self._target, self._rate_hz, self._budget_bytes = target, rate_hz, budget_bytes
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._size_px = (0, 0)
        self._written = 0
        self._first_s, self._pts = 0.0, -1

    @property
    def is_full(self) -> bool:
        """Whether the budget is used up."""
        return self._written >= self._budget_bytes

    def put(self, picture: Picture, time_s: float) -> None:
        """Write a picture. Raises OSError."""
        try:
            self._put(picture, time_s)
        except av.FFmpegError as error:  # some of them are no OSError
            raise OSError(str(error)) from error

    def _put(self, picture: Picture, time_s: float) -> None:
        height, width = picture.shape[:2]
        if self._container is None:
            url = f"{self._target}?pkt_size=1316" if self._target.startswith("udp:") else self._target
            self._container = av.open(url, "w", format="mpegts")
            self._stream = self._container.add_stream("libx264", rate=Fraction(self._rate_hz).limit_denominator(100))
            self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
            self._stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": str(round(2 * self._rate_hz))}
            self._stream.codec_context.time_base = Fraction(1, 1000)
            self._size_px, self._first_s = (width, height), time_s
        if self.is_full:
            return
        if (width, height) != self._size_px:
            picture = cv2.resize(picture, self._size_px)  # type: ignore[assignment]
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        self._pts = max(round(1000.0 * (time_s - self._first_s)), self._pts + 1)  # the clocks' offset may step back
        frame.pts, frame.time_base = self._pts, Fraction(1, 1000)
        self._mux(frame)

    def close(self) -> None:
        """Write what is left."""
        if self._container is not None:
            with contextlib.suppress(av.FFmpegError, OSError):
                self._mux(None)
                self._container.close()
            self._container = None

    def _mux(self, frame: av.VideoFrame | None) -> None:
        assert self._stream is not None
        assert self._container is not None
        for packet in self._stream.encode(frame):
            self._written += packet.size
            self._container.mux(packet)

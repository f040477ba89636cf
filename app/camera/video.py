"""Video in and out, by PyAV: sources of any kind in a thread of their own, and MPEG-TS with H.264 and KLV."""

from __future__ import annotations

import contextlib
import json
import math
import re
import socket
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt
import stanag4609
from stanag4609.transport import encode_pes_packet, synchronous_klv_stream
from stanag4609.transport.psi import ElementaryStreamInfo

from sidelong.app.errors import InputError

Picture = npt.NDArray[np.uint8]

_FORMS = "rtsp://HOST/PATH, udp://HOST:PORT, /dev/videoN or a video file"
_OPEN_S, _READ_S, _RETRY_S, _WHOLE_AFTER_S = 5.0, 1.5, 0.5, 10.0
_WIDTH_MAX_PX = 1280
_H264, _VIDEO, _METADATA, _CLOCK_HZ, _DECODED_LATER, _IN_DATAGRAM = 0x1B, 0x100, 0x101, 90_000, 27_000, 7
_SLICE = re.compile(rb"\x00?\x00\x00\x01[\x01\x05\x21\x25\x41\x45\x61\x65]")  # the first unit of a picture's pixels
_CLOCK_EVERY, _CLOCK_FILLED = 8_100, 900_000  # ticks: ST 1402 wants the clock each 0.1 s, also while no picture comes
_GAP_S, _AHEAD_S, _SAME_S, _JPEG_QUALITY = 0.5, 3.0, 2e-3, 60
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
        self._damaged_s = -math.inf
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
        """End the thread that reads the video."""
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
            except (av.FFmpegError, OSError, ValueError, LookupError) as error:  # PyAV: a stream that damage invents
                why = getattr(error, "strerror", None) or str(error) or type(error).__name__
                if isinstance(error, av.ExitError):
                    why = "nothing arrives"  # what a timeout raises
            if self._is_file:
                break
            if not silent:
                silent = True
                self._report(f"video {self._source}: no picture ({why}); trying again each {_RETRY_S:g} s")
            self._closing.wait(_RETRY_S)
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def _note_damage(self) -> None:
        """Report damage, once until the video has been whole for some time."""
        now_s, self.damaged = time.monotonic(), self.damaged + 1
        if now_s > self._damaged_s + _WHOLE_AFTER_S:
            self._report(f"video {self._source}: the stream is damaged; pictures are lost or wrong")
        self._damaged_s = now_s

    def _put(self, picture: Picture) -> None:
        with self._changed:
            self.dropped += self._latest is not None
            self._latest = picture, time.monotonic()
            self._changed.notify_all()

    def _decoded(self) -> Iterator[Picture]:
        options = {"fflags": "nobuffer", "flags": "low_delay", "rtsp_transport": "tcp"}
        url = self._source
        if url.startswith("udp:"):
            url += ("&" if "?" in url else "?") + "overrun_nonfatal=1&fifo_size=8000"  # packets of 188 bytes
            options |= {"probesize": "65536", "analyzeduration": "200000"}
        kind = "v4l2" if url.startswith("/dev/") else None
        with av.open(url, format=kind, options=options, timeout=(_OPEN_S, _READ_S)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"  # threads by picture would each delay it
            begun_s = first_s = shown_s = math.nan
            for packet in container.demux(stream):
                is_damaged = packet.is_corrupt
                try:
                    frames = packet.decode()
                except av.FFmpegError:
                    frames, is_damaged = [], True
                if is_damaged or any(frame.is_corrupt for frame in frames):
                    self._note_damage()
                for frame in frames:
                    if abs((frame.time or math.nan) - shown_s - 0.5 * _GAP_S) > 0.5 * _GAP_S:
                        self._note_damage()  # a cut that fits the packets' numbers shows in the times alone
                    shown_s = frame.time or math.nan
                    if self._paced and frame.time is not None:
                        if math.isnan(first_s):
                            first_s, begun_s = frame.time, time.monotonic()
                        self._closing.wait(max(0.0, begun_s + frame.time - first_s - time.monotonic()))
                    width = min(frame.width, _WIDTH_MAX_PX)
                    height = round(frame.height * width / frame.width / 2) * 2
                    yield np.asarray(frame.to_ndarray(format="bgr24", width=width, height=height), np.uint8)


class VideoReplay:
    """Reads a recording again, by the times of its pictures. Raises OSError when there is none that can be read.

    Args:
        path: The recording; what was drawn on it is next to it.
    """

    def __init__(self, path: Path) -> None:
        lines = path.with_suffix(".jsonl").read_bytes().splitlines(keepends=True)
        self._marks = [line for line in lines if line.endswith(b"\n")]
        self._times_s = [float(json.loads(line)["time_s"]) for line in self._marks]
        self._container = av.open(str(path))
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._at_s = math.inf

    def shown(self, time_s: float) -> bytes | None:
        """Return the picture of a time as the page takes it; None before the first one, and what is damaged."""
        index = bisect_right(self._times_s, time_s) - 1
        if index < 0:
            return None
        wanted_s = self._times_s[index]
        if not self._at_s < wanted_s < self._at_s + _AHEAD_S:
            before_s = max(wanted_s - _AHEAD_S, self._times_s[0])  # decoding begins at the next key picture
            self._container.seek(round(before_s * av.time_base))
            self._frames = self._container.decode(video=0)
        with contextlib.suppress(av.FFmpegError):
            for frame in self._frames:
                self._at_s = float(frame.time or 0.0)
                if self._at_s >= wanted_s - _SAME_S:
                    return encoded(self._marks[index], np.asarray(frame.to_ndarray(format="bgr24"), np.uint8))
        self._at_s = math.inf
        return None


def encoded(marks: bytes, picture: Picture) -> bytes:
    """Return a picture for the page: a line of JSON with what is drawn on it, and the picture as JPEG."""
    return marks + cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


class VideoOutput:
    """Encodes pictures as H.264 and writes them with their metadata as MPEG-TS, to a file and to a network address.

    The presentation time stamps are the times of the pictures. Source: MISB ST 1402 (synchronous metadata), ST 0604.

    Args:
        rate_hz: Pictures per second, for the encoder's budget of bits.
        file: Where to write; None: nowhere.
        budget_bytes: Largest size of the file.
        address: Where to send, as UDP: host and port; None: nowhere.
    """

    def __init__(
        self,
        rate_hz: float,
        file: Path | None,
        budget_bytes: float = math.inf,
        address: tuple[str, int] | None = None,
    ) -> None:
        self._rate_hz, self._address = rate_hz, address
        self._file = None if file is None else file.open("wb")
        self._left_bytes = budget_bytes
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._encoder: av.VideoCodecContext | None = None
        self._pts, self._clock = -1, 0
        video = ElementaryStreamInfo(_H264, _VIDEO, ())
        metadata = synchronous_klv_stream(_METADATA, metadata_input_leak_rate=500, metadata_buffer_size=8)
        self._muxer = stanag4609.TransportMuxer(
            transport_stream_id=1, program_number=1, program_map_pid=0x1000, pcr_pid=_VIDEO, streams=[video, metadata]
        )

    @property
    def is_full(self) -> bool:
        """Whether the file's budget is used up."""
        return self._left_bytes <= 0.0

    def put(self, picture: Picture, time_s: float, stamp_us: int | None = None, klv: bytes = b"") -> None:
        """Write a picture, with its precision time stamp and metadata if there are any. Raises OSError."""
        encoder = self._encoder = self._encoder or self._new_encoder(picture)
        size_px = encoder.width, encoder.height
        if size_px != picture.shape[1::-1]:
            picture = cv2.resize(picture, size_px)  # type: ignore[assignment]
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        self._pts = max(round(_CLOCK_HZ * time_s), self._pts + 1)  # the clocks' offset may step back
        frame.pts, frame.time_base = self._pts, Fraction(1, _CLOCK_HZ)
        muxer, packets = self._muxer, [*self._muxer.program_tables()]
        clock = max(self._pts - _DECODED_LATER, 0)
        filled = min(clock, self._clock + _CLOCK_FILLED) if self._clock else 0
        late = range(self._clock + _CLOCK_EVERY, filled, _CLOCK_EVERY)
        packets += [muxer.mux_pcr(stanag4609.pcr_from_ticks(300 * ticks)) for ticks in (*late, clock)]
        self._clock = clock
        try:
            encoded = b"".join(map(bytes, encoder.encode(frame)))
        except av.FFmpegError as error:  # some of them are no OSError
            raise OSError(str(error)) from error
        if stamp_us is not None and (slice_unit := _SLICE.search(encoded)) is not None:
            at = slice_unit.start()
            encoded = encoded[:at] + stanag4609.encode_avc_timestamp_sei(stamp_us) + encoded[at:]
        pts = self._pts % 2**33
        video = [*muxer.mux_pes(_VIDEO, encode_pes_packet(encoded, stream_id=0xE0, pts=pts, unbounded=True))]
        metadata = muxer.mux_sync_klv(_METADATA, klv, pts=pts) if klv else ()
        apart = 1 + len(video) // max(len(metadata), 1)
        for number, packet in enumerate(metadata):  # a decoder's buffer of 512 bytes takes no three of them at once
            video.insert(1 + number * apart, packet)
        self._write(packets + video)

    def close(self) -> None:
        """Close the file and the socket."""
        if self._file is not None:
            self._file.close()
        self._socket.close()

    def _write(self, packets: list[bytes]) -> None:
        if self._address is not None:
            with contextlib.suppress(OSError):
                for at in range(0, len(packets), _IN_DATAGRAM):
                    self._socket.sendto(b"".join(packets[at : at + _IN_DATAGRAM]), self._address)
        if self._file is not None and not self.is_full:
            self._left_bytes -= self._file.write(b"".join(packets))

    def _new_encoder(self, picture: Picture) -> av.VideoCodecContext:
        encoder = av.CodecContext.create("libx264", "w")
        assert isinstance(encoder, av.VideoCodecContext)
        encoder.height, encoder.width = (side // 2 * 2 for side in picture.shape[:2])
        encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, _CLOCK_HZ)
        encoder.framerate = Fraction(self._rate_hz).limit_denominator(100)
        encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "g": str(round(2 * self._rate_hz))}
        encoder.options["x264-params"] = "aud=1:repeat-headers=1"
        return encoder

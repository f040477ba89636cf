"""Sidelong's transports under MAVSDK's raw connection: one link or several to one vehicle, signed or not.

Threads: each transport's thread receives, a MAVSDK thread sends, and one thread here measures the delay of each link.
One lock protects their shared data; no MAVSDK call and no blocking call is made while it is held. Another lock keeps
the order in which frames are passed on.

What an autopilot sends many times a second waits a moment and is passed on together, before any other message: each
time that the program wakes costs more than a message does.
"""

from __future__ import annotations

import contextlib
import re
import struct
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.errors import InputError
from sidelong.app.link.frames import Frame, FrameSplitter, message_ids
from sidelong.app.link.quality import LinkQuality, LinkReport, Measured
from sidelong.app.link.signing import RADIO_STATUS_ID, KeyInUse, LinkSigning, Refusal, key_in_use, signing_time
from sidelong.app.link.transport import Peer, Transport, checked_url, opened
from sidelong.app.network import Allowances

AUTOPILOT_COMPONENT = 1
_ANSWERS = message_ids(
    "COMMAND_ACK PARAM_VALUE MISSION_ITEM MISSION_ITEM_INT MISSION_REQUEST MISSION_REQUEST_INT MISSION_COUNT "
    "MISSION_ACK AUTOPILOT_VERSION STATUSTEXT"
)
_SILENT_S, _SPARSE_SILENT_S, _SPARSE_BYTES_S = 1.0, 3.5, 200.0
_FRESH_S = 0.5
_WORSE_BY, _WORSE_FOR_S = 0.15, 3.0
_UNANSWERED_S = 3.0  # some questions may be lost
_COPY_WITHIN_S, _TIMED_COPY_WITHIN_S = 1.0, 10.0
_STEP_BACK_S = 5.0  # as in telemetry: the vehicle has rebooted
_AHEAD_S, _AHEAD_PER_S, _BEHIND_S = 5.0, 1.5, 10.0
_PROOF_COUNT, _PROOF_STEP_S, _PROOF_SILENCE_S = 5, 5.0, 2.0
_KEPT_MAX = 4000


_UNITS_PER_S = {"time_boot_ms": 1e3, "time_usec": 1e6}


def _clock_of(definition: Any) -> tuple[int, str, float] | None:
    """Return where a message has its time: offset, format and units per second; None where it has none."""
    codes = re.findall(r"\d*[a-zA-Z]", definition.unpacker.format)
    for index, (name, code) in enumerate(zip(definition.ordered_fieldnames, codes, strict=True)):
        if name in _UNITS_PER_S and code in ("I", "Q"):
            return struct.calcsize("<" + "".join(codes[:index])), "<" + code, _UNITS_PER_S[name]
    return None


_CLOCKS = {number: _clock_of(definition) for number, definition in dialect.mavlink_map.items()}


def time_of(frame: Frame) -> float | None:
    """Return the time stamp of a frame's message, s, of the sender's clock; None where it has none."""
    clock = _CLOCKS.get(frame.message_id)
    if clock is None:
        return None
    offset, code, units_per_s = clock
    return float(struct.unpack_from(code, frame.payload[offset:].ljust(8, b"\0"))[0]) / units_per_s


@dataclass(slots=True)
class _Newest:
    """The newest stamp of one kind of message: its link, when it came, and a series of stamps far from it."""

    stamp_s: float
    link: int
    received_s: float
    far_s: float = 0.0
    far_count: int = 0

    def take(self, stamp_s: float, link: int, now_s: float) -> None:
        self.stamp_s, self.link, self.received_s, self.far_count = stamp_s, link, now_s, 0

    def is_far(self, stamp_s: float, now_s: float) -> bool:
        """Return whether a stamp cannot be the next one, nor an older one of a later link."""
        passed_s = now_s - self.received_s
        return not -_BEHIND_S <= stamp_s - self.stamp_s <= _AHEAD_S + _AHEAD_PER_S * passed_s

    def proves(self, stamp_s: float, now_s: float) -> bool:
        """Take a stamp far from the newest; return whether enough of them have followed one another."""
        goes_on = 0.0 <= stamp_s - self.far_s <= _PROOF_STEP_S
        self.far_count = self.far_count + 1 if goes_on and self.far_count else 1
        self.far_s = stamp_s
        return self.far_count >= _PROOF_COUNT and now_s - self.received_s >= _PROOF_SILENCE_S


class LinkMerger:
    """Decides for each frame; ``in_use`` is the index of the link that is spoken on."""

    def __init__(self, links: int) -> None:
        self.in_use = 0
        self._links = links
        self._caught_up = True
        self._leads_to_autopilot: set[int] = set()
        self._worse_since_s: float | None = None
        self._newest: dict[tuple[tuple[int, int], int], _Newest] = {}
        self._newest_of_link_s: dict[tuple[int, tuple[int, int], int], float] = {}
        self._passed: dict[tuple[tuple[int, int], int, bytes], list[tuple[float, set[int]]]] = {}

    def passes(self, link: int, frame: Frame, now_s: float) -> bool:
        """Process a frame of a link, by its index; return whether to deliver it, False for copies and late frames."""
        if self._links == 1:
            return True
        if frame.component_id == AUTOPILOT_COMPONENT:
            if not self._leads_to_autopilot:
                self.in_use = link
            self._leads_to_autopilot.add(link)
        stamp_s = time_of(frame)
        if frame.component_id != AUTOPILOT_COMPONENT or frame.message_id in _ANSWERS:
            window_s = _COPY_WITHIN_S if stamp_s is None else _TIMED_COPY_WITHIN_S
            return not self._is_copy(link, frame, now_s, window_s)
        if stamp_s is None:
            return link == self.in_use and self._caught_up
        return self._is_newest(link, frame, stamp_s, now_s)

    def _is_newest(self, link: int, frame: Frame, stamp_s: float, now_s: float) -> bool:
        kind = (frame.source, frame.message_id)
        own_s = self._newest_of_link_s.get((link, *kind), stamp_s)
        self._newest_of_link_s[(link, *kind)] = stamp_s
        newest = self._newest.get(kind)
        if newest is None:
            newest = self._newest[kind] = _Newest(stamp_s, link, now_s)
        restarted = stamp_s < own_s - _STEP_BACK_S and stamp_s < newest.stamp_s and link == newest.link
        if not restarted:
            if newest.is_far(stamp_s, now_s):
                if not newest.proves(stamp_s, now_s):
                    return False
            elif stamp_s < newest.stamp_s or (stamp_s == newest.stamp_s and link != newest.link):
                return False
        newest.take(stamp_s, link, now_s)
        self._caught_up |= link == self.in_use
        return True

    def _is_copy(self, link: int, frame: Frame, now_s: float, window_s: float) -> bool:
        """Return whether another link has already delivered this frame; each earlier frame matches one copy only."""
        key = (frame.source, frame.message_id, frame.payload)
        passed = [entry for entry in self._passed.get(key, ()) if now_s - entry[0] < window_s]
        self._passed[key] = passed
        for _, links in passed:
            if link not in links:
                links.add(link)
                return True
        passed.append((now_s, {link}))
        if len(self._passed) > _KEPT_MAX:
            self._passed = {k: p for k, p in self._passed.items() if now_s - p[-1][0] < _TIMED_COPY_WITHIN_S}
        return False

    def choose(self, measured: Sequence[Measured], now_s: float) -> bool:
        """Switch to a better link if there is one; return whether the link in use changed."""
        others = [i for i in self._leads_to_autopilot - {self.in_use} if measured[i].silent_s < _FRESH_S]
        if not others:
            self._worse_since_s = None
            return False
        best, present = min(others, key=lambda i: _badness(measured[i])), measured[self.in_use]
        sparse = present.received_bytes_s < _SPARSE_BYTES_S and present.silent_s < _SPARSE_SILENT_S
        if present.silent_s < _SILENT_S or sparse:
            if _badness(present) < _badness(measured[best]) + _WORSE_BY:
                self._worse_since_s = None
                return False
            if self._worse_since_s is None:
                self._worse_since_s = now_s
            if now_s - self._worse_since_s < _WORSE_FOR_S:
                return False
        self.in_use, self._caught_up, self._worse_since_s = best, False, None
        return True


def _badness(measured: Measured) -> float:
    unanswered_s = max(measured.unanswered_s - _UNANSWERED_S, 0.0)
    return (measured.loss or 0.0) + (measured.round_trip_s or 0.0) + unanswered_s


_ASK_DELAY_S = 1.0
_WATCH_S = 0.1
_BACK_AFTER_S = 3.0  # after this silence, message rates are requested again on a link that returns
_SPLITTERS_MAX = 64
_COMMAND_LONG, _TIMESYNC = dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_TIMESYNC
_HEARTBEAT, _HEARTBEAT_S = dialect.MAVLINK_MSG_ID_HEARTBEAT, 1.0
_COMMANDS = message_ids("COMMAND_LONG COMMAND_INT")
_COMMAND_AT, _TARGET_SYSTEM_AT = 28, 30  # in the payloads of both
DO_AUX_FUNCTION = int(dialect.MAV_CMD_DO_AUX_FUNCTION)
_ON_EVERY_LINK = message_ids("TIMESYNC")
_SET_MESSAGE_INTERVAL = (511).to_bytes(2, "little")
_MAY_WAIT = message_ids(
    "ATTITUDE GLOBAL_POSITION_INT MISSION_CURRENT CURRENT_MODE DISTANCE_SENSOR GIMBAL_DEVICE_ATTITUDE_STATUS"
)
_WAIT_S, _WAITING_MAX = 0.05, 8  # frames; a fast simulation fills it sooner
UNREAD = message_ids(
    "RAW_IMU SCALED_PRESSURE ATTITUDE_QUATERNION LOCAL_POSITION_NED SERVO_OUTPUT_RAW NAV_CONTROLLER_OUTPUT VFR_HUD "
    "ATTITUDE_TARGET HIGHRES_IMU SCALED_IMU2 POWER_STATUS SCALED_IMU3 SCALED_PRESSURE2 ALTITUDE AHRS VIBRATION "
    "ODOMETRY"
)
"""What autopilots send unasked and nothing here reads: it is recorded and not passed on."""

FrameListener = Callable[[bytes], object]


@dataclass(slots=True)
class _Link:
    url: str
    transport: Transport
    signing: LinkSigning | None
    quality: LinkQuality
    splitters: OrderedDict[Peer, FrameSplitter] = field(default_factory=OrderedDict)
    refused: Counter[Refusal] = field(default_factory=Counter)
    authentic: bool = False  # a fresh signed frame was accepted: from now on only such frames identify a peer
    has_mavlink_2: bool = False  # such a frame was accepted
    sequence: int = 0
    asked: dict[int, float] = field(default_factory=dict)
    traffic: Allowances = field(default_factory=lambda: Allowances(4e6, 1e6))  # bytes of each sender
    damage: Allowances = field(default_factory=lambda: Allowances(2e3, 500.0))  # what seems to be a frame and is none


class RawLinks:
    """Passes accepted frames to ``deliver``, and outgoing frames to the link in use.

    on_frame: receives every frame that is accepted or sent, before it is signed. on_trouble: receives a sentence
    when frames are refused or the link in use changes. on_request (an attribute): receives each DO_AUX_FUNCTION of
    any station to any address, and each command to a component of ``served`` (system, component). All are called
    from several threads. heartbeats: the latest one of each sender.
    """

    def __init__(
        self,
        transports: Sequence[tuple[str, Transport]],
        own: tuple[int, int],
        key: KeyInUse | None,
        on_frame: FrameListener | None = None,
        on_trouble: Callable[[str], object] = lambda _text: None,
    ) -> None:
        now_s = time.monotonic()
        self._own = own
        self._on_frame, self._on_trouble = on_frame or (lambda _data: None), on_trouble
        self._lock = key.locked if key is not None else threading.Lock()
        signings = [None if key is None else LinkSigning(key.key, key.times, k, own) for k in range(len(transports))]
        self._links = [
            _Link(url, transport, signing, LinkQuality(now_s))
            for (url, transport), signing in zip(transports, signings, strict=True)
        ]
        self.urls = [url for url, _ in transports]
        self._merger = LinkMerger(len(self._links))
        self._packer = dialect.MAVLink(None, srcSystem=own[0], srcComponent=own[1])
        self.heartbeats: dict[tuple[int, int], Frame] = {}
        self._heartbeat: Any = None
        self._rates: dict[bytes, Frame] = {}
        self._deliver: Callable[[bytes], object] = lambda _data: None
        self._waiting: list[bytes] = []
        self._waiting_since_s = 0.0
        self._delivering = threading.Lock()
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="links", daemon=True)
        self.on_request: Callable[[Frame], object] = lambda _frame: None
        self.served: set[tuple[int, int]] = set()
        self.measures_delay = False  # by questions to the vehicle, whose answers give the delay of each link
        self._is_signing_noted = False

    def deliver_to(self, deliver: Callable[[bytes], object], first: Iterable[bytes]) -> None:
        """Deliver to another receiver from now on, and before that what the previous one has kept."""
        with self._delivering:
            self._deliver = deliver
            for data in first:
                deliver(data)

    def start(self, deliver: Callable[[bytes], object]) -> None:
        """Begin to receive; ``deliver`` takes whole frames, one or several, from several threads."""
        self._deliver = deliver
        for index, link in enumerate(self._links):
            link.transport.start(lambda data, peer, index=index: self._received(index, data, peer))  # type: ignore[misc]
        self._watcher.start()

    def speak_as(self, own: tuple[int, int], mav_type: int) -> None:
        """Send heartbeats as this system and component, of this MAV_TYPE, from now on."""
        with self._lock:
            self._own, self._packer = own, dialect.MAVLink(None, srcSystem=own[0], srcComponent=own[1])
            for link in self._links:
                if link.signing is not None:
                    link.signing.own = own
        none, active = dialect.MAV_AUTOPILOT_INVALID, dialect.MAV_STATE_ACTIVE
        self._heartbeat = dialect.MAVLink_heartbeat_message(mav_type, none, 0, 0, active, 3)

    def close(self) -> None:
        """End the threads and close the transports; safe to call more than once."""
        if self._closing.is_set():
            return
        self._closing.set()
        for link in self._links:
            link.transport.close()
        if self._watcher.is_alive():
            self._watcher.join(2.0)

    @property
    def received_since_s(self) -> float | None:
        """When the first frame arrived on any link, monotonic clock; None: none has."""
        received_s = (link.quality.received_since_s for link in self._links)
        return min((since_s for since_s in received_s if since_s is not None), default=None)

    def reports(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link since it was opened."""
        return self._reports(LinkQuality.total)

    def recent(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link over the last seconds."""
        return self._reports(LinkQuality.measured)

    def _reports(self, measure: Callable[[LinkQuality, float], Measured]) -> tuple[LinkReport, ...]:
        with self._lock:
            now_s = time.monotonic()
            return tuple(
                LinkReport(
                    link.url,
                    link.signing is not None,
                    index == self._merger.in_use,
                    measure(link.quality, now_s),
                    {str(why): count for why, count in link.refused.items()},
                    link.quality.received_s is not None and not link.has_mavlink_2,
                )
                for index, link in enumerate(self._links)
            )

    # -- out -----------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Send frames on the link in use; send those that every link needs on all links."""
        for frame in FrameSplitter().split(data):  # whole frames, from several threads
            if not frame.is_v2 or (frame.message_id == _HEARTBEAT and frame.source not in self.served):
                continue  # MAVLink 1 could not be signed; a heartbeat of MAVSDK names no companion's type
            self._on_frame(frame.data)
            rate = frame.message_id == _COMMAND_LONG and frame.payload[28:30] == _SET_MESSAGE_INTERVAL
            if rate:
                self._rates[frame.payload[:4]] = frame  # param1: which message
            everywhere = rate or frame.message_id in _ON_EVERY_LINK
            for index in range(len(self._links)) if everywhere else (self._merger.in_use,):
                self._send_on(index, frame)

    def _send_on(self, index: int, frame: Frame) -> None:
        link, now_s = self._links[index], time.monotonic()
        with self._lock:
            data = frame.renumbered(link.sequence, signed=link.signing is not None)
            link.sequence = (link.sequence + 1) & 0xFF
            if link.signing is not None:
                data = link.signing.signed(data, signing_time(time.time()))
            link.quality.sent(len(data), now_s)
            link.transport.send(data)  # in the lock: times and sequence numbers leave in their order

    # -- in ------------------------------------------------------------------------------------------------

    def _received(self, index: int, data: bytes, peer: Peer) -> bool:
        link, now_s = self._links[index], time.monotonic()
        if link.damage.left(peer, now_s) < 1.0 or not link.traffic.used(peer, now_s, len(data)):
            return False
        splitter = link.splitters.setdefault(peer, FrameSplitter())
        link.splitters.move_to_end(peer)
        while len(link.splitters) > _SPLITTERS_MAX:
            link.splitters.popitem(last=False)
        peers, damaged = False, splitter.damaged
        frames = splitter.split(data)
        if splitter.damaged > damaged:
            link.damage.used(peer, now_s, splitter.damaged - damaged)
        for frame in frames:
            passed, is_peer, troubles = self._judged(index, frame)
            peers |= is_peer
            for trouble in troubles:
                self._on_trouble(trouble)
            if passed:
                if frame.message_id == _HEARTBEAT:
                    self.heartbeats[frame.source] = frame
                self._on_frame(frame.data)
                if frame.message_id not in UNREAD and not self._is_taken(frame):
                    self._pass_on(frame)
        return peers

    def _is_taken(self, frame: Frame) -> bool:
        """Hand out a command that MAVSDK does not pass on; return whether it is addressed to us, and taken.

        MAVSDK passes on no command that is addressed to another system, or from one without heartbeats.
        """
        if frame.message_id not in _COMMANDS:
            return False
        payload = frame.payload.ljust(_TARGET_SYSTEM_AT + 2, b"\0")
        if tuple(payload[_TARGET_SYSTEM_AT : _TARGET_SYSTEM_AT + 2]) in self.served:
            self.on_request(frame)
            return True
        if int.from_bytes(payload[_COMMAND_AT:_TARGET_SYSTEM_AT], "little") != DO_AUX_FUNCTION:
            return False
        self.on_request(frame)
        to_system, to_component = payload[_TARGET_SYSTEM_AT : _TARGET_SYSTEM_AT + 2]
        return to_system == self._own[0] and to_component in (0, self._own[1])

    def _pass_on(self, frame: Frame) -> None:
        with self._delivering:
            if not self._waiting:
                self._waiting_since_s = time.monotonic()
            self._waiting.append(frame.data)
            full = frame.message_id not in _MAY_WAIT or len(self._waiting) >= _WAITING_MAX
        if full or self._has_waited:
            self.flush()

    @property
    def _has_waited(self) -> bool:
        return time.monotonic() >= self._waiting_since_s + _WAIT_S

    def flush(self) -> None:
        """Deliver the frames that wait to be delivered together."""
        with self._delivering:
            if self._waiting:
                data = b"".join(self._waiting)
                self._waiting.clear()
                self._deliver(data)

    def _judged(self, index: int, frame: Frame) -> tuple[bool, bool, list[str]]:
        """Return whether to pass on a frame, whether its sender is a peer, and the messages for the operator."""
        link, now_s = self._links[index], time.monotonic()
        with self._lock:
            if frame.message_id == RADIO_STATUS_ID and not frame.signed:
                # Sent by the radio itself, which has no key. It is used for the link's statistics only.
                # On the wire: rxerrors, fixed (2 bytes each), rssi, remrssi, txbuf, noise, remnoise.
                rssi, remote_rssi = frame.payload.ljust(9, b"\0")[4:6]
                link.quality.radio(rssi, remote_rssi)
                self._on_frame(frame.data)
                return False, False, []
            refusal = None
            if link.signing is not None:
                refusal = link.signing.refusal(frame, signing_time(time.time()))
            elif frame.source == self._own:
                refusal = Refusal.OWN
            if refusal is Refusal.OWN and len(self._links) > 1:
                return False, True, []  # the vehicle passes on to one link what came by another
            if refusal is not None:
                link.refused[refusal] += 1
                count = link.refused[refusal]
                announced = count == 1 or (count >= 1000 and str(count).strip("0") == "1")
                words = [f"{link.url}: {count} frame{'s' * (count > 1)} refused, {refusal}"] if announced else []
                genuine = link.signing is not None and not link.authentic and link.signing.genuine(frame)
                return False, genuine and refusal is Refusal.OLD, words
            link.authentic = True
            link.has_mavlink_2 |= frame.is_v2
            troubles = self._signing_note(frame) if link.signing is None else []
            silent_s = now_s - link.quality.received_s if link.quality.received_s is not None else 0.0
            link.quality.frame(frame.source, frame.sequence, len(frame.data), now_s)
            if frame.message_id == _TIMESYNC and self._is_answer(link, frame, now_s):
                return index == self._merger.in_use, True, troubles  # it carries the vehicle's clock, too
            passed = self._merger.passes(index, frame, now_s)
        if silent_s > _BACK_AFTER_S and len(self._links) > 1:
            for rate in list(self._rates.values()):
                self._send_on(index, rate)
        return passed, True, troubles

    def _signing_note(self, frame: Frame) -> list[str]:
        """Return the note, once, about a vehicle that signs on links that do not."""
        if self._is_signing_noted or not frame.signed or frame.component_id != AUTOPILOT_COMPONENT:
            return []
        self._is_signing_noted = True
        return ["the vehicle signs its messages: without link.signing_key_file it may reject ours"]

    def _is_answer(self, link: _Link, frame: Frame, now_s: float) -> bool:
        asked_s = link.asked.pop(int.from_bytes(frame.payload.ljust(16, b"\0")[8:16], "little"), None)
        if asked_s is None:
            return False
        link.quality.answered(now_s - asked_s, now_s)
        return True

    # -- other ---------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        ask_s = beat_s = 0.0
        while not self._closing.wait(_WATCH_S):
            if self._has_waited:
                self.flush()
            now_s = time.monotonic()
            if self._heartbeat is not None and now_s >= beat_s:
                beat_s = now_s + _HEARTBEAT_S
                heartbeat = Frame(self._heartbeat.pack(self._packer))
                self._on_frame(heartbeat.data)
                for index in range(len(self._links)):
                    self._send_on(index, heartbeat)
            if self.measures_delay and now_s >= ask_s:
                ask_s = now_s + _ASK_DELAY_S
                for index in range(len(self._links)):
                    self._ask_delay(index, now_s)
            if len(self._links) > 1:
                with self._lock:
                    before = self._merger.in_use
                    changed = self._merger.choose([link.quality.measured(now_s) for link in self._links], now_s)
                    now_used = self._merger.in_use
                if changed:
                    self._on_trouble(f"link {self._links[before].url} is bad: using {self._links[now_used].url}")

    def _ask_delay(self, index: int, now_s: float) -> None:
        stamp = time.monotonic_ns()
        asked = self._links[index].asked
        with self._lock:
            asked[stamp] = now_s
            self._links[index].quality.asked(now_s)
            while len(asked) > 32:
                del asked[next(iter(asked))]
        self._send_on(index, Frame(dialect.MAVLink_timesync_message(0, stamp).pack(self._packer)))


def opened_url(url: str) -> Transport:
    """Return the transport of a URL. Raises InputError for a bad URL or a port in use, OSError beyond that."""
    return opened(checked_url(url))


@contextlib.contextmanager
def opened_links(
    urls: Sequence[str],
    own: tuple[int, int],
    key: Path | KeyInUse | None,
    on_frame: FrameListener | None = None,
    on_trouble: Callable[[str], object] = lambda _text: None,
    open_transport: Callable[[str], Transport] = opened_url,
) -> Iterator[RawLinks]:
    """Open a transport for each URL; with a key, or its file, all are signed.

    Raises InputError for a bad URL, a port or device that cannot be opened, and a key file that cannot be used.
    """
    with contextlib.ExitStack() as stack:
        if isinstance(key, Path):
            key = stack.enter_context(key_in_use(key, signing_time(time.time()), on_trouble))
        transports: list[tuple[str, Transport]] = []
        for url in urls:
            try:
                transport = open_transport(url)
            except ConnectionRefusedError as error:
                raise InputError(
                    f"{url!r}: connection refused; start the autopilot first, or correct the URL."
                ) from error
            except OSError as error:
                reason = error.strerror or error
                raise InputError(f"{url!r} could not be opened ({reason}); check the address or device.") from error
            stack.callback(transport.close)
            transports.append((url, transport))
        links = RawLinks(transports, own, key, on_frame, on_trouble)
        stack.callback(links.close)
        yield links

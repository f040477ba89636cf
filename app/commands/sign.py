"""``sidelong sign``: a key for signed links, made here, given to a vehicle and removed from it (SETUP_SIGNING)."""

from __future__ import annotations

import ipaddress
import queue
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.commands.output import console, say
from sidelong.app.errors import FlightError, InputError
from sidelong.app.link.frames import Frame, FrameSplitter
from sidelong.app.link.signing import (
    KEY_BYTES,
    RADIO_STATUS_ID,
    KeyInUse,
    LinkSigning,
    key_in_use,
    make_key,
    read_key,
    signing_time,
)
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_INVALID
from sidelong.app.link.transport import Peer, checked_url, opened

_OWN = (245, 190)
_LISTEN_S = 2.0  # for a radio: its status comes every second
_TRIES, _TRY_S = 8, 1.0
_ASKED_BACK_S = 1.0
_AUTOPILOT = 1


def checked_local_url(url: str) -> str:
    """Return the URL as ``checked_url`` does. Raises InputError where the key would go over a network."""
    scheme, _, rest = url.partition("://")
    address = checked_url(url)
    if scheme.startswith("serial"):
        return address
    host = address.partition("://")[2].rpartition(":")[0]
    if not ipaddress.ip_address(host).is_loopback:
        raise InputError(
            f"{url!r}: a key is sent in the clear and only over a cable; connect the vehicle by USB "
            f"(serial:///dev/ttyACM0:115200) or give a loopback address instead of {rest.rpartition(':')[0]}."
        )
    return address


class KeySetup:
    """A vehicle on a local link. Use as ``with``."""

    def __init__(self, url: str, key: KeyInUse) -> None:
        address = checked_local_url(url)
        self._url, self._key = url, key
        self._signing = LinkSigning(key.key, key.times, 0, _OWN)
        self._packer = dialect.MAVLink(None, srcSystem=_OWN[0], srcComponent=_OWN[1])
        self._splitters: dict[Peer, FrameSplitter] = {}
        self._frames: queue.Queue[Frame] = queue.Queue()
        try:
            self._transport = opened(address)
        except OSError as error:
            raise InputError(f"{url!r} could not be opened ({error.strerror or error}); check the device.") from error

    def __enter__(self) -> KeySetup:
        self._transport.start(self._received)
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

    def _received(self, data: bytes, peer: Peer) -> bool:
        frames = self._splitters.setdefault(peer, FrameSplitter()).split(data)
        for frame in frames:
            self._frames.put(frame)
        return bool(frames)

    def set_up(self, timeout_s: float, remove: bool) -> bool:
        """Set the key up, or end signing; return whether this link then refuses what is unsigned."""
        system_id = self._checked(timeout_s)
        secret = ([0] * KEY_BYTES, 0) if remove else (self._key.key.for_setup(), signing_time(time.time()))
        setup = dialect.MAVLink_setup_signing_message(system_id, _AUTOPILOT, *secret)
        if not self._announced(setup, system_id, signed=remove, proves=self._unsigned if remove else self._fresh):
            question = "still signs; is this the key that it was given?"
            if not remove:
                question = "does not sign with the key; does its firmware know signing?"
            raise FlightError(f"{self._url}: the vehicle {question}")
        return not remove and not self._answers_unsigned(system_id)

    def _checked(self, timeout_s: float) -> int:
        """Return the vehicle's system id; refuse an armed vehicle, and one behind a radio."""
        heartbeat = self._awaited(timeout_s, _is_autopilot)
        if heartbeat is None:
            raise InputError(f"{self._url!r}: no autopilot was received within {timeout_s:g} s; check the link.")
        if self._awaited(_LISTEN_S, lambda frame: frame.message_id == RADIO_STATUS_ID) is not None:
            raise InputError(f"{self._url!r} goes over a radio: a key is sent in the clear; use a cable.")
        if heartbeat.payload.ljust(9, b"\0")[6] & ARMED_FLAG:
            raise InputError("the vehicle is armed; disarm it first: a key is set up on the ground only.")
        return heartbeat.system_id

    def _announced(self, setup: Any, system_id: int, *, signed: bool, proves: Callable[[Frame], bool]) -> bool:
        """Send until an autopilot's heartbeat proves that it was taken: the message itself is never answered."""
        for _ in range(_TRIES):
            self._send(setup, signed)
            if self._awaited(_TRY_S, lambda one: _is_autopilot(one) and one.system_id == system_id and proves(one)):
                return True
        return False

    def _answers_unsigned(self, system_id: int) -> bool:
        version = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        request = dialect.MAVLink_command_long_message(
            system_id, _AUTOPILOT, dialect.MAV_CMD_REQUEST_MESSAGE, 0, version, *[0] * 6
        )
        self._send(request, signed=False)
        answer = dialect.MAVLINK_MSG_ID_COMMAND_ACK
        return self._awaited(_ASKED_BACK_S, lambda frame: frame.message_id == answer) is not None

    @staticmethod
    def _unsigned(frame: Frame) -> bool:
        return not frame.signed

    def _fresh(self, frame: Frame) -> bool:
        with self._key.locked:
            return self._signing.refusal(frame, signing_time(time.time())) is None

    def _send(self, message: Any, signed: bool) -> None:
        heartbeat = dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
        )
        for each in (heartbeat, message):
            data = Frame(each.pack(self._packer)).renumbered(self._packer.seq, signed=signed)
            self._packer.seq = (self._packer.seq + 1) & 0xFF
            if signed:
                with self._key.locked:
                    data = self._signing.signed(data, signing_time(time.time()))
            self._transport.send(data)

    def _awaited(self, timeout_s: float, wanted: Callable[[Frame], bool]) -> Frame | None:
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            try:
                frame = self._frames.get(timeout=left_s)
            except queue.Empty:
                return None
            if wanted(frame):
                return frame
        return None


def _is_autopilot(frame: Frame) -> bool:
    is_heartbeat = frame.message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT and frame.component_id == _AUTOPILOT
    return bool(is_heartbeat and frame.payload.ljust(9, b"\0")[5] != AUTOPILOT_INVALID)


def sign(
    key: Annotated[Path, typer.Argument(help="The key's file; made if it is not there.")],
    connect: Annotated[str | None, typer.Option(help="URL of the vehicle that is to have it, by cable.")] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Take the key back from the vehicle.")] = False,
    timeout: Annotated[float, typer.Option(min=1.0, help="Wait this long for a heartbeat, s.")] = 10.0,
) -> None:
    """Make a key for MAVLink signing and set it up on a vehicle. The vehicle then accepts only signed messages.

    Disarm the vehicle and connect it by cable: the key is sent unencrypted. Then fly with
    --set link.signing_key_file=FILE.

    For example:
      sidelong sign plane.key
      sidelong sign plane.key --connect serial:///dev/ttyACM0:115200
      sidelong sign plane.key --connect serial:///dev/ttyACM0:115200 --remove
    """
    if remove and connect is None:
        raise InputError("--remove needs the vehicle: give --connect URL.")
    if connect is not None:
        checked_local_url(connect)
    if key.exists():
        read_key(key)
    elif remove:
        raise InputError(f"{key} is not there; --remove needs the key that the vehicle has.")
    else:
        make_key(key)
        say(f"made {key}: copy it only to machines that may command the vehicle")
    if connect is None:
        return
    with key_in_use(key, signing_time(time.time()), console.print) as used, KeySetup(connect, used) as setup:
        say(f"waiting for a heartbeat on {connect}")
        refuses = setup.set_up(timeout, remove)
        if remove:
            console.print("the vehicle no longer signs and accepts commands from any sender")
        elif refuses:
            console.print("the vehicle signs, and refuses frames that are not signed with the key")
        else:
            say("the vehicle signs; on this very port it still takes what is unsigned (ArduPlane does so on USB)")

"""MAVLink FTP, as far as ground stations use it: listing and reading, no writing."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

_HEADER = struct.Struct("<HBBBBBxI")  # sequence, session, opcode, size, requested opcode, burst complete, offset
_DATA_MAX = 239
_BURST_PACKETS = 20


class _Op(IntEnum):
    NONE = 0
    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN = 4
    READ = 5
    CRC32 = 14
    BURST = 15
    ACK = 128
    NAK = 129


class FileErrors(IntEnum):
    FAILED = 1
    WRONG_SESSION = 4
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    NOT_FOUND = 10


@dataclass(frozen=True, slots=True)
class _Request:
    sequence: int
    session: int
    opcode: int
    size: int
    offset: int
    path: str

    @staticmethod
    def from_payload(payload: bytes) -> _Request:
        payload = payload.ljust(_HEADER.size + _DATA_MAX, b"\0")
        sequence, session, opcode, size, _, _, offset = _HEADER.unpack_from(payload)
        text = payload[_HEADER.size : _HEADER.size + size].split(b"\0")[0].decode("ascii", "replace")
        return _Request(sequence, session, opcode, size, offset, text.split("?")[0].strip("/"))

    def ack(self, data: bytes = b"", offset: int = 0, number: int = 0, last: bool = False) -> bytes:
        sequence = (self.sequence + 1 + number) & 0xFFFF
        head = _HEADER.pack(sequence, self.session, _Op.ACK, len(data), self.opcode, last, offset)
        return head + data.ljust(_DATA_MAX, b"\0")

    def nak(self, error: FileErrors) -> bytes:
        sequence = (self.sequence + 1) & 0xFFFF
        head = _HEADER.pack(sequence, self.session, _Op.NAK, 1, self.opcode, 0, self.offset)
        return head + bytes([error]).ljust(_DATA_MAX, b"\0")


class FileServer:
    """Answers the payloads of FILE_TRANSFER_PROTOCOL. files: by their whole paths, made when they are opened.

    One file is open at a time; its content does not change while it is open. unknown, not_open: the autopilot's
    refusals of an unknown request, and of reading a file that is not open.
    """

    def __init__(
        self,
        files: Mapping[str, Callable[[], bytes]],
        unknown: FileErrors = FileErrors.UNKNOWN_COMMAND,
        not_open: FileErrors = FileErrors.WRONG_SESSION,
    ) -> None:
        self._files = files
        self._unknown, self._not_open = unknown, not_open
        self._content: bytes | None = None
        self._session = 0

    def answers(self, payload: bytes) -> list[bytes]:
        """Return the payloads to send back, none to what is no request."""
        request = _Request.from_payload(payload)
        match request.opcode:
            case _Op.ACK | _Op.NAK:
                return []
            case _Op.NONE:
                return [request.ack()]
            case _Op.TERMINATE | _Op.RESET:
                self._content = None
                return [request.ack()]
            case _Op.LIST:
                return [self._list(request)]
            case _Op.OPEN | _Op.CRC32:
                return [self._opened(request)]
            case _Op.READ | _Op.BURST:
                return self._read(request)
        return [request.nak(self._unknown)]

    def _list(self, request: _Request) -> bytes:
        """Return the entries of a folder from number ``offset`` on, as many as there is room for."""
        folder = f"{request.path}/" if request.path else ""
        inside = sorted({path.removeprefix(folder).split("/")[0] for path in self._files if path.startswith(folder)})
        if folder and not inside:
            return request.nak(FileErrors.NOT_FOUND)
        data = b""
        for name in inside[request.offset :]:
            path = folder + name
            told = f"F{name}\t{len(self._files[path]())}" if path in self._files else f"D{name}"
            entry = told.encode("ascii") + b"\0"
            if len(data) + len(entry) > _DATA_MAX:
                break
            data += entry
        return request.ack(data, request.offset) if data else request.nak(FileErrors.END_OF_FILE)

    def _opened(self, request: _Request) -> bytes:
        make = self._files.get(request.path)
        if make is None:
            return request.nak(FileErrors.NOT_FOUND)
        content = make()
        if request.opcode == _Op.CRC32:
            return request.ack(struct.pack("<I", zlib.crc32(content)))
        self._content, self._session = content, request.session
        return request.ack(struct.pack("<I", len(content)))

    def _read(self, request: _Request) -> list[bytes]:
        if self._content is None or request.session != self._session:
            return [request.nak(self._not_open)]
        if request.offset >= len(self._content):
            return [request.nak(FileErrors.END_OF_FILE)]
        step = min(request.size or _DATA_MAX, _DATA_MAX)
        packets = _BURST_PACKETS if request.opcode == _Op.BURST else 1
        pieces = range(request.offset, min(len(self._content), request.offset + packets * step), step)
        return [
            request.ack(self._content[begin : begin + step], begin, number, number + 1 == len(pieces))
            for number, begin in enumerate(pieces)
        ]

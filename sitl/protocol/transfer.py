"""The vehicle's side of the mission protocol: upload, download, clear, set current.

One upload at a time for each mission type. The vehicle requests one item after the other and repeats unanswered
requests; it cancels an upload whose sender is silent. The vehicle's :class:`Store` decides whether each item is
stored on arrival or the whole list is replaced at the end.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.radio import Extended, Radio, Station

ACCEPTED_ITEMS: int = mavlink.MAV_MISSION_ACCEPTED


class Store:
    """Items that are replaced as a whole when all have come. All results are MAV_MISSION_RESULT."""

    def __init__(self, with_checksum: bool) -> None:
        self.with_checksum = with_checksum
        self._items: list[Item] = []
        self._arriving: list[Item] = []

    def items(self) -> list[Item]:
        return self._items

    def current_index(self) -> int:
        """Return the number of the item that is current, -1: the store has no such item."""
        return -1

    def opaque_id(self) -> int | None:
        """Return a checksum of the items, None where the autopilot has none."""
        return checksum(self._items) if self.with_checksum else None

    def begin(self, count: int) -> int:
        """Take the items that follow, ``count`` of them, 0: none; return a MAV_MISSION_RESULT."""
        self._arriving = []
        return self.clear() if count == 0 else ACCEPTED_ITEMS

    def put(self, index: int, item: Item, current: bool) -> None:
        """Store an item. Raises ItemRefused."""
        self._arriving.append(item)

    def finish(self) -> int:
        """Replace the stored items by the upload, which is complete."""
        self._items, self._arriving = self._arriving, []
        return ACCEPTED_ITEMS

    def abandon(self) -> int | None:
        """Forget the upload: it was cut. Return the checksum of what had come."""
        arrived_id = checksum(self._arriving) if self.with_checksum else None
        self._arriving = []
        return arrived_id

    def clear(self) -> int:
        """Forget all items; return a MAV_MISSION_RESULT."""
        self._items = []
        return ACCEPTED_ITEMS


ABSOLUTE_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)


class ItemRefused(Exception):
    """An item that the vehicle rejects; ``result`` is the MAV_MISSION_RESULT of the rejection."""

    def __init__(self, result: int) -> None:
        super().__init__(f"MAV_MISSION_RESULT {result}")
        self.result = result


@dataclass(frozen=True, slots=True)
class Item:
    """latitude_e7 and longitude_e7 are 1e-7 degrees, altitude_m is in ``frame``; params are 1 to 4."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    latitude_e7: int
    longitude_e7: int
    altitude_m: float
    autocontinue: int = 1

    @staticmethod
    def from_message(message: Any) -> Item:
        """Read a MISSION_ITEM_INT or a MISSION_ITEM. Raises ItemRefused for a place that is none."""
        x, y = message.x, message.y
        if message.get_type() == "MISSION_ITEM":
            if not (abs(x) <= 90.0 and abs(y) <= 180.0):
                raise ItemRefused(mavlink.MAV_MISSION_INVALID)
            x, y = round(x * 1e7), round(y * 1e7)
        params = message.param1, message.param2, message.param3, message.param4
        return Item(message.command, message.frame, params, x, y, message.z, message.autocontinue)

    def message(self, sequence: int, mission_type: int, current: bool, to: tuple[int, int], as_int: bool) -> Any:
        """Return MISSION_ITEM_INT or MISSION_ITEM, to (system, component)."""
        x, y = (self.latitude_e7, self.longitude_e7) if as_int else (self.latitude_e7 / 1e7, self.longitude_e7 / 1e7)
        kind = mavlink.MAVLink_mission_item_int_message if as_int else mavlink.MAVLink_mission_item_message
        head = sequence, self.frame, self.command, int(current), self.autocontinue
        return kind(*to, *head, *self.params, x, y, self.altitude_m, mission_type)

    @property
    def has_position(self) -> bool:
        return self.frame in ABSOLUTE_FRAMES or self.frame in RELATIVE_FRAMES

    @property
    def latitude_deg(self) -> float:
        return self.latitude_e7 / 1e7

    @property
    def longitude_deg(self) -> float:
        return self.longitude_e7 / 1e7

    def with_params(self, *params: float) -> Item:
        """Return a copy with these first params; those left out are 0."""
        first, second, third, fourth = (*params, 0.0, 0.0, 0.0, 0.0)[:4]
        return replace(self, params=(first, second, third, fourth))


def checksum(items: list[Item]) -> int:
    """Return a number that differs when the items do, 0 without items."""
    if not items:
        return 0
    rows = [(i.command, i.frame, i.params, i.latitude_e7, i.longitude_e7, i.altitude_m) for i in items]
    return zlib.crc32(repr(rows).encode())


@dataclass(frozen=True, slots=True)
class TransferQuirks:
    """How this autopilot behaves in the protocol; times in seconds of the stations' clock."""

    asks_with_int: bool  # MISSION_REQUEST_INT, or the older MISSION_REQUEST
    retry_s: float
    timeout_s: float
    max_items: int
    partial_writes: bool
    reads_in_order: bool  # a list is read from its first item on; the vehicle is busy until the ack
    busy_result: int  # the answer to anyone else while an upload runs
    restarts: bool  # a new count restarts the upload at any time, or only before item 0 arrives
    wrong_sequence_result: int | None  # None: the item is ignored
    repeats_final_ack: bool  # a second copy of the item that came last is acknowledged, also where not all have come
    timeout_result: int | None
    timeout_severity: int
    timeout_text: str
    names_lists: bool = True  # by a checksum in acknowledgements and counts, where the store has one


@dataclass(slots=True)
class _Upload:
    station: Station
    sender: tuple[int, int]
    next_index: int
    last_index: int
    asked_s: float
    received_s: float


@dataclass(slots=True)
class _Download:
    sender: tuple[int, int]
    count: int
    next_index: int
    received_s: float


class Transfer:
    """Serves one mission type. transfers: all of the vehicle, including this one; in-order reads block all."""

    def __init__(
        self,
        mission_type: int,
        store: Store,
        radio: Radio,
        quirks: TransferQuirks,
        link_rate: float,
        announce: Callable[[int, str], None],
        transfers: Mapping[int, Transfer],
    ) -> None:
        self.mission_type, self.store = mission_type, store
        self._radio, self._quirks = radio, quirks
        self._retry_s, self._timeout_s = quirks.retry_s * link_rate, quirks.timeout_s * link_rate
        self._announce, self._transfers = announce, transfers
        self.upload: _Upload | None = None
        self._latest: tuple[tuple[int, int], int, int | None] | None = None  # sender, index and checksum
        self.downloads: dict[Station, _Download] = {}  # the in-order downloads

    def is_busy_with(self, station: Station) -> bool:
        """Return whether it serves only the list that this station reads or writes."""
        return self._quirks.reads_in_order and (self._is_written_by(station) or self._read_by(station) is not None)

    def _is_written_by(self, station: Station) -> bool:
        uploads = (transfer.upload for transfer in self._transfers.values())
        return any(upload is not None and upload.station is station for upload in uploads)

    def _read_by(self, station: Station) -> Transfer | None:
        return next((transfer for transfer in self._transfers.values() if station in transfer.downloads), None)

    def step(self, now_s: float) -> None:
        """Ask again or give up where a station has been silent."""
        for station, download in list(self.downloads.items()):
            if now_s - download.received_s > self._timeout_s:
                del self.downloads[station]
                self._announce(self._quirks.timeout_severity, self._quirks.timeout_text)
        upload = self.upload
        if upload is None:
            return
        if now_s - upload.received_s > self._timeout_s:
            self._abandon(upload)
            self._announce(self._quirks.timeout_severity, self._quirks.timeout_text)
            if self._quirks.timeout_result is not None:
                self._acknowledge(upload.station, upload.sender, self._quirks.timeout_result)
        elif now_s - upload.asked_s > self._retry_s:
            self._ask(upload, now_s)

    def handle(self, station: Station, message: Any, now_s: float) -> None:
        """Take a message of the mission protocol; others are ignored."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        match message.get_type():
            case "MISSION_COUNT":
                self._on_count(station, sender, message, now_s)
            case "MISSION_WRITE_PARTIAL_LIST":
                self._on_partial(station, sender, message, now_s)
            case "MISSION_ITEM_INT" | "MISSION_ITEM":
                self._on_item(station, sender, message, now_s)
            case "MISSION_REQUEST_LIST" if self._quirks.reads_in_order:
                self._on_list_in_order(station, sender, now_s)
            case "MISSION_REQUEST_LIST" if self.upload is not None:
                self._acknowledge(station, sender, self._quirks.busy_result)
            case "MISSION_REQUEST_LIST":
                self._send_count(station, sender, now_s)
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST" if self._quirks.reads_in_order and self.upload is None:
                self._on_request_in_order(station, sender, message, now_s)
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                self._on_request(station, sender, message)
            case "MISSION_CLEAR_ALL":
                self._on_clear(station, sender)
            case "MISSION_ACK":
                self.downloads.pop(station, None)
                breaks_off = message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED
                if self.upload is not None and self.upload.sender == sender and breaks_off:
                    self._abandon(self.upload)

    def _on_count(self, station: Station, sender: tuple[int, int], message: Any, now_s: float) -> None:
        if not self._may_start(station, sender):
            return
        if message.count > self._quirks.max_items:
            self._acknowledge(station, sender, mavlink.MAV_MISSION_NO_SPACE)
            return
        result = self.store.begin(message.count)
        if result != ACCEPTED_ITEMS or message.count == 0:
            self._acknowledge(station, sender, result)
            return
        self.upload = _Upload(station, sender, 0, message.count - 1, now_s, now_s)
        self._ask(self.upload, now_s)

    def _on_partial(self, station: Station, sender: tuple[int, int], message: Any, now_s: float) -> None:
        if not self._quirks.partial_writes:
            return
        if self.upload is not None:
            self._acknowledge(station, sender, self._quirks.busy_result)
            return
        first, last, count = message.start_index, message.end_index, len(self.store.items())
        if not 0 <= first <= last <= count:
            self._acknowledge(station, sender, mavlink.MAV_MISSION_ERROR)
            return
        self.upload = _Upload(station, sender, first, last, now_s, now_s)
        self._ask(self.upload, now_s)

    def _may_start(self, station: Station, sender: tuple[int, int]) -> bool:
        upload = self.upload
        if self._read_by(station) is not None:
            self._announce(mavlink.MAV_SEVERITY_CRITICAL, "WPM: IGN MISSION_COUNT: Busy\t")
            self._acknowledge(station, sender, self._quirks.busy_result)
            return False
        if upload is not None and (upload.sender != sender or not (self._quirks.restarts or upload.next_index == 0)):
            self._acknowledge(station, sender, self._quirks.busy_result)
            return False
        if upload is not None:
            self._abandon(upload)
        return True

    def _ask(self, upload: _Upload, now_s: float) -> None:
        kind = mavlink.MAVLink_mission_request_message
        if self._quirks.asks_with_int:
            kind = mavlink.MAVLink_mission_request_int_message
        self._radio.send(upload.station, kind(*upload.sender, upload.next_index, self.mission_type))
        upload.asked_s = now_s

    def _on_item(self, station: Station, sender: tuple[int, int], message: Any, now_s: float) -> None:
        upload, quirks = self.upload, self._quirks
        if upload is None:
            latest = self._latest if quirks.repeats_final_ack and station not in self.downloads else None
            again = latest is not None and latest[:2] == (sender, message.seq)
            result = mavlink.MAV_MISSION_ACCEPTED if again else mavlink.MAV_MISSION_ERROR
            self._acknowledge(station, sender, result, latest[2] if latest is not None and again else None)
            return
        if message.seq != upload.next_index:
            if quirks.wrong_sequence_result is not None:
                self._acknowledge(station, sender, quirks.wrong_sequence_result)
            return
        if upload.sender != sender:
            self._acknowledge(station, sender, quirks.busy_result)
            return
        upload.received_s = now_s
        try:
            self.store.put(message.seq, Item.from_message(message), bool(message.current))
        except ItemRefused as refusal:
            self._abandon(upload)
            self._acknowledge(station, sender, refusal.result)
            return
        upload.next_index += 1
        if upload.next_index <= upload.last_index:
            self._ask(upload, now_s)
            return
        self.upload = None
        result = self.store.finish()
        self._latest = (sender, upload.last_index, self.store.opaque_id())
        self._acknowledge(station, sender, result)

    def _abandon(self, upload: _Upload) -> None:
        self.upload = None
        self._latest = (upload.sender, upload.next_index - 1, self.store.abandon())

    def _send_count(self, station: Station, sender: tuple[int, int], now_s: float) -> None:
        count = len(self.store.items())
        if self._quirks.reads_in_order:
            self.downloads[station] = _Download(sender, count, 0, now_s)
        message = mavlink.MAVLink_mission_count_message(*sender, count, self.mission_type)
        self._radio.send(station, Extended(message, self._list_id()))

    def _on_request(self, station: Station, sender: tuple[int, int], message: Any) -> None:
        if self.upload is not None:
            self._acknowledge(station, sender, self._quirks.busy_result)
            return
        items = self.store.items()
        if not 0 <= message.seq < len(items):
            self._acknowledge(station, sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)
            return
        current, as_int = message.seq == self.store.current_index(), message.get_type() == "MISSION_REQUEST_INT"
        item = items[message.seq].message(message.seq, self.mission_type, current, sender, as_int)
        self._radio.send(station, item)

    def _on_request_in_order(self, station: Station, sender: tuple[int, int], message: Any, now_s: float) -> None:
        """Send the next item, or the one before again; any other ends the reading."""
        download = self.downloads.get(station)
        if download is None or download.sender != sender:
            return
        download.received_s = now_s
        if message.seq == download.next_index and download.next_index < download.count:
            download.next_index += 1
        elif message.seq != download.next_index - 1:
            del self.downloads[station]
            self._acknowledge(station, sender, mavlink.MAV_MISSION_ERROR)
            self._announce(mavlink.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected\t")
            return
        self._on_request(station, sender, message)

    def _on_list_in_order(self, station: Station, sender: tuple[int, int], now_s: float) -> None:
        """Begin to be read, unless another list is; one whose last item was sent is taken for read."""
        reading = self._read_by(station)
        if reading is not None:
            download = reading.downloads[station]
            if download.next_index == download.count:
                del reading.downloads[station]
            elif reading is not self or download.sender != sender:
                self._announce(mavlink.MAV_SEVERITY_INFO, "Mission download request ignored, already active\t")
                return
        if self._is_written_by(station):
            self._announce(mavlink.MAV_SEVERITY_INFO, "Mission download request ignored, already active\t")
            return
        self._send_count(station, sender, now_s)

    def _on_clear(self, station: Station, sender: tuple[int, int]) -> None:
        if self.is_busy_with(station):  # reported as a status text only
            self._announce(mavlink.MAV_SEVERITY_CRITICAL, "WPM: IGN CLEAR CMD: Busy\t")
        elif self._may_start(station, sender):
            self._acknowledge(station, sender, self.store.clear())

    def _acknowledge(
        self, station: Station, sender: tuple[int, int], result: int, opaque_id: int | None = None
    ) -> None:
        list_id = self._list_id() if opaque_id is None or not self._quirks.names_lists else opaque_id
        message = mavlink.MAVLink_mission_ack_message(*sender, result, self.mission_type)
        self._radio.send(station, Extended(message, list_id))

    def _list_id(self) -> int:
        return (self.store.opaque_id() or 0) if self._quirks.names_lists else 0

"""A relay between a real autopilot and the application: it loses, delays and cuts."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from typing import Self

import numpy as np

from sidelong.app.flight.shell import free_udp_port
from sidelong.app.link.frames import Frame, FrameSplitter
from sidelong.sitl.server import FaultyLink
from sidelong.sitl.settings import LinkFaults

GOOD = LinkFaults()
_CONNECTS_WITHIN_S, _AGAIN_S = 20.0, 0.2
_WAKE_S = 0.05


class Relay:
    """Joins the vehicle at a URL and reports the application of it, which meets it at ``url``. Use as ``with``.

    Whole frames come through or not, unchanged. cut: nothing comes through, either way; it may be set at any time.
    """

    def __init__(self, vehicle_url: str, faults: LinkFaults = GOOD, seed: int = 1) -> None:
        self.meet(vehicle_url)
        self._vehicle_address: tuple[str, int] | None = None
        self.cut = False
        self.spoil(faults, seed)
        ours = ("127.0.0.1", free_udp_port())
        self.url = f"udpin://{ours[0]}:{ours[1]}"
        self._application = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._application.connect(ours)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def meet(self, vehicle_url: str) -> None:
        """Join a vehicle at another URL: one that starts after the application."""
        scheme, _, address = vehicle_url.partition("://")
        host, _, port = address.rpartition(":")
        self._is_stream, self._there = scheme.startswith("tcp"), (host, int(port))

    def __enter__(self) -> Self:
        if self._is_stream:
            self._vehicle = _connected(self._there)
        else:
            self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._vehicle.bind(self._there)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(10.0)
        self._vehicle.close()
        self._application.close()

    def spoil(self, faults: LinkFaults, seed: int = 1) -> None:
        """Make both ways as bad as that from now on; what is under way is lost."""
        self._to_vehicle, self._to_application = (
            FaultyLink[bytes](faults, np.random.default_rng((seed, way))) for way in (1, 2)
        )

    # -- the thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        splitters = {self._vehicle: FrameSplitter(), self._application: FrameSplitter()}
        on_message = {self._vehicle: self._from_vehicle, self._application: self._from_application}
        while not self._ended.is_set():
            next_s = min(self._to_vehicle.next_s, self._to_application.next_s) - time.monotonic()
            for ready in select.select(list(on_message), [], [], min(max(next_s, 0.0), _WAKE_S))[0]:
                for frame in splitters[ready].split(self._received(ready)):
                    if not self.cut:
                        on_message[ready](frame, time.monotonic())
            for data in self._to_application.take(time.monotonic()):
                self._send_to_application(data)
            for data in self._to_vehicle.take(time.monotonic()):
                self._send_to_vehicle(data)

    def _from_vehicle(self, frame: Frame, now_s: float) -> None:
        self._to_application.put(frame.data, now_s, len(frame.data))

    def _from_application(self, frame: Frame, now_s: float) -> None:
        self._to_vehicle.put(frame.data, now_s, len(frame.data))

    def _received(self, ready: socket.socket) -> bytes:
        try:
            data, address = ready.recvfrom(65_536)
        except ConnectionError:
            return b""  # the application is not there, or no longer
        if ready is self._vehicle:
            self._vehicle_address = address
            if self._is_stream and not data:  # the program has ended its connection
                self._ended.set()
        return data

    def _send_to_application(self, data: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            self._application.send(data)

    def _send_to_vehicle(self, data: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            if self._is_stream:
                self._vehicle.sendall(data)
            elif self._vehicle_address is not None:
                self._vehicle.sendto(data, self._vehicle_address)


def _connected(there: tuple[str, int]) -> socket.socket:
    """Connect as soon as the program is ready."""
    deadline_s = time.monotonic() + _CONNECTS_WITHIN_S
    while True:
        try:
            return socket.create_connection(there)
        except ConnectionRefusedError:
            assert time.monotonic() < deadline_s, f"nothing answers at {there}"
            time.sleep(_AGAIN_S)

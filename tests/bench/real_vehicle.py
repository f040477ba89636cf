"""Someone's own SITL program with payload and target, behind links of any quality."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from app.flight.simulated import free_udp_port
from app.link.frames import FrameSplitter
from sitl.link import FaultyLink, LinkFaults

ROOT = Path(__file__).parents[2]
FLAVOURS = ("arduplane", "px4")
AIRCRAFT = {"arduplane": (22, 80, 60), "px4": (15, 60, 45)}  # of the stock simulators: m/s, m, degrees
_SECOND_PORT = {"arduplane": 3, "px4": 14030 - 14540}  # from that of the first link; the payload has another one
_WAKE_S = 0.05


class RealVehicle:
    """The program that SIDELONG_ARDUPLANE or SIDELONG_PX4 names. Use as ``with``.

    ``urls``: of its first and its second link, as the program serves them.
    """

    def __init__(self, flavour: str, *options: object) -> None:
        name = f"SIDELONG_{flavour.upper()}"
        if not os.environ.get(name):
            pytest.skip(f"{name} does not name a SITL program")
        command = [sys.executable, "-m", "sitl", "--autopilot", flavour, "--binary", os.environ[name], *options]
        self._sitl = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        )
        assert self._sitl.stdout is not None
        first = self._sitl.stdout.readline().split()[-1]
        host, _, port = first.rpartition(":")
        self.urls = [first, f"{host}:{int(port) + _SECOND_PORT[flavour]}"]

    def __enter__(self) -> RealVehicle:
        return self

    def __exit__(self, *_: object) -> None:
        self._sitl.send_signal(signal.SIGTERM)
        self._sitl.wait(20.0)


class Relay:
    """Stands between a link of the program and ours: ``url`` is where the vehicle is met then. Use as ``with``.

    cut: nothing comes through, either way.
    """

    def __init__(self, url: str, faults: LinkFaults, seed: int = 1) -> None:
        scheme, _, address = url.partition("://")
        self._tcp = scheme.startswith("tcp")
        self._there = (address.partition(":")[0], int(address.partition(":")[2]))
        self._to_vehicle, self._to_us = (
            FaultyLink[bytes](faults, np.random.default_rng((seed, direction))) for direction in (1, 2)
        )
        self.cut = False
        port = free_udp_port()
        self.url = f"udpin://127.0.0.1:{port}"
        self._us = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._us.connect(("127.0.0.1", port))
        self._peer: tuple[str, int] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Relay:
        if self._tcp:
            self._vehicle = self._connected()
        else:
            self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._vehicle.bind(self._there)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._vehicle.close()
        self._us.close()

    def _connected(self) -> socket.socket:
        for _ in range(100):
            try:
                return socket.create_connection(self._there)
            except ConnectionRefusedError:  # the program begins to listen when it is ready
                time.sleep(0.2)
        raise AssertionError(f"nothing answers at {self._there}")

    def _serve(self) -> None:
        splitters = {self._vehicle: FrameSplitter(), self._us: FrameSplitter()}
        links = {self._vehicle: self._to_us, self._us: self._to_vehicle}
        while not self._ended.is_set():
            next_s = min(link.next_s for link in links.values()) - time.monotonic()
            for ready in select.select(list(links), [], [], min(max(next_s, 0.0), _WAKE_S))[0]:
                for frame in splitters[ready].split(self._received(ready)):
                    if not self.cut:
                        links[ready].put(frame.data, time.monotonic(), len(frame.data))
            for data in self._to_us.take(time.monotonic()):
                self._send(self._us.send, data)
            for data in self._to_vehicle.take(time.monotonic()):
                if self._tcp:
                    self._send(self._vehicle.sendall, data)
                elif self._peer is not None:
                    self._send(lambda frame: self._vehicle.sendto(frame, self._peer), data)

    def _received(self, ready: socket.socket) -> bytes:
        try:
            if ready is self._vehicle and not self._tcp:
                data, self._peer = ready.recvfrom(65_536)
                return data
            return ready.recv(65_536)
        except ConnectionError:
            return b""  # our program is not there, or no longer

    @staticmethod
    def _send(send: Callable[[bytes], object], data: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            send(data)


def configured(path: Path, flavour: str, more: str = "") -> Path:
    """Write a configuration for the stock aircraft."""
    airspeed_m_s, radius_m, bank_max_deg = AIRCRAFT[flavour]
    path.write_text(
        f"[aircraft]\nairspeed_m_s = {airspeed_m_s}\nradius_m = {radius_m}\nbank_max_deg = {bank_max_deg}\n{more}"
    )
    return path

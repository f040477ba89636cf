"""The simulation behind a UDP socket, paced by the wall clock."""

from __future__ import annotations

import contextlib
import heapq
import math
import select
import socket
import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from sidelong.sitl.payload.devices import Address, DevicePort
from sidelong.sitl.settings import LinkFaults
from sidelong.sitl.simulation import STEP_S, Simulation

_WAKE_MIN_S = 0.004
_LAG_MAX_S = 0.25  # of the wall clock; further behind, the simulation goes slower instead of catching up
_DEVICE_LAG_MAX_S = 0.01  # what a device sends has no stamp: caught up at once, it would all seem to be of one moment
_DATAGRAM_MAX = 4096
_LINK_STREAM = 2  # of the seed's children: 0 and 1 are the target's and the sensors'
_LEAD_S, _LEAD_WALL_S, _LEAD_MAX_S = 0.3, 0.02, 0.75
_SILENT_MAX_S = 2.0


_BUFFER_BYTES = 4096  # of a slow line; what comes when it is full is lost
_BITS_PER_BYTE = 10  # with start and stop bit

T = TypeVar("T")


class FaultyLink(Generic[T]):
    """One direction. What is put in comes out when its time has come."""

    def __init__(self, faults: LinkFaults, rng: np.random.Generator) -> None:
        self.faults = faults
        self._rng = rng
        self._waiting: list[tuple[float, int, T]] = []
        self._count = 0
        self._latest_s = -float("inf")
        self._free_s = -float("inf")  # when the line has carried all that it was given

    def put(self, datagram: T, now_s: float, size_bytes: int = 0) -> None:
        """Send a datagram, which the link may lose, delay or double."""
        lost, doubled = self._rng.random(2)
        bytes_per_s = self.faults.baud / _BITS_PER_BYTE
        waiting_s = max(0.0, self._free_s - now_s)
        if waiting_s * bytes_per_s > _BUFFER_BYTES:
            return
        sent_s = now_s + waiting_s + size_bytes / bytes_per_s
        self._free_s = sent_s
        if lost < self.faults.loss:
            return
        for _ in range(2 if doubled < self.faults.duplicate else 1):
            self._count += 1
            jitter_s = self.faults.jitter_s * self._rng.random() if self.faults.jitter_s else 0.0
            due_s = sent_s + self.faults.delay_s + jitter_s
            if not jitter_s:  # in order, even where the delay has become shorter
                due_s = self._latest_s = max(due_s, self._latest_s)
            heapq.heappush(self._waiting, (due_s, self._count, datagram))

    def take(self, now_s: float) -> list[T]:
        """Return the datagrams that have arrived by now."""
        taken = []
        while self._waiting and self._waiting[0][0] <= now_s:
            taken.append(heapq.heappop(self._waiting)[2])
        return taken

    @property
    def next_s(self) -> float:
        """When the next one comes out; infinity if none waits."""
        return self._waiting[0][0] if self._waiting else float("inf")


class Pace:
    """Limits the simulation's lead over the controlling program, which reports the time it has processed.

    The lead adds to the delay of each exchange between the two. It is limited to the delay of a real link, so a busy
    machine slows the simulation down instead of degrading its link. The simulation does not wait for a program that
    has reported nothing yet, or nothing for two seconds of wall time.
    """

    def __init__(self, speed: float) -> None:
        self._lead_s = min(_LEAD_S + _LEAD_WALL_S * speed, _LEAD_MAX_S)
        self._reported: tuple[float, float] | None = None

    def follow(self, time_s: float, now_s: float) -> None:
        """Store that the program has processed ``time_s`` of the simulation at wall time ``now_s``."""
        self._reported = time_s, now_s

    def limit_s(self, now_s: float) -> float:
        """Return the time of the simulation that it may go to."""
        if self._reported is None or now_s - self._reported[1] > _SILENT_MAX_S:
            return math.inf
        return self._reported[0] + self._lead_s


class _Port:
    def __init__(self, simulation: Simulation, stations: Sequence[Address], faults: LinkFaults) -> None:
        seed = np.random.SeedSequence(simulation.settings.seed, spawn_key=(_LINK_STREAM,))
        out_rng, in_rng = (np.random.default_rng(child) for child in seed.spawn(2))
        self.simulation = simulation
        self._outward: FaultyLink[tuple[Address, bytes]] = FaultyLink(faults, out_rng)
        self._inward: FaultyLink[tuple[Address, bytes]] = FaultyLink(faults, in_rng)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        loopback = all(host.startswith("127.") for host, _ in stations)
        self.socket.bind(("127.0.0.1" if loopback else "", 0))
        self.socket.setblocking(False)
        for address in stations:
            simulation.connect(address)

    @property
    def next_s(self) -> float:
        """When a delayed packet is due."""
        return min(self._inward.next_s, self._outward.next_s)

    def advance(self, to_s: float, now_s: float) -> None:
        self.simulation.advance(to_s)
        for address, data in self._inward.take(now_s):
            self.simulation.receive(address, data)
        for datagram in self.simulation.take():
            # This shell's stations are UDP addresses.
            self._outward.put(datagram, now_s, len(datagram[1]))  # type: ignore[arg-type]
        for address, data in self._outward.take(now_s):
            try:
                self.socket.sendto(data, address)
            except (BlockingIOError, ConnectionError):
                continue  # as lost as on the air

    def receive(self) -> None:
        now_s = time.monotonic()
        while True:
            try:
                data, address = self.socket.recvfrom(_DATAGRAM_MAX)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # a station has gone; the next datagram may be another's
            self._inward.put((address, data), now_s, len(data))


def serve(
    served: Sequence[tuple[Simulation, Sequence[Address]]],
    *,
    speed: float = 1.0,
    duration_s: float = float("inf"),
    faults: LinkFaults | None = None,
    on_ready: Callable[[], None] = lambda: None,
    stopped: Callable[[], bool] = lambda: False,
    pace: Pace | None = None,
    device_address: Address | None = None,
) -> None:
    """Fly until ``stopped`` or for duration_s, all vehicles on one clock.

    Each sends to its stations and to every sender on its socket. speed: simulated time over wall time.
    pace: limits the simulation time. device_address: where the first vehicle's device listens.
    """
    ports: dict[socket.socket, _Port] = {}
    devices: list[DevicePort] = []
    with contextlib.ExitStack() as stack:
        if device_address is not None:
            first = served[0][0]
            devices.append(DevicePort(first.settings.device, first, device_address))
            stack.callback(devices[0].close)
        for simulation, stations in served:
            port = _Port(simulation, stations, faults or LinkFaults())
            ports[stack.enter_context(port.socket)] = port
        on_ready()
        lag_max_s = max(_DEVICE_LAG_MAX_S, 2.0 * STEP_S / speed) if devices else _LAG_MAX_S
        clock = served[0][0]  # they all have the same time
        begin_s = time.monotonic() - clock.time_s / speed
        while clock.time_s < duration_s and not stopped():
            now_s = time.monotonic()
            goal_s = (now_s - begin_s) * speed
            lag_s = goal_s - clock.time_s - lag_max_s * speed
            if lag_s > 0.0:
                begin_s += lag_s / speed
                goal_s -= lag_s
            if pace is not None:
                goal_s = min(goal_s, pace.limit_s(now_s))
            for port in ports.values():
                port.advance(min(goal_s, duration_s), now_s)
            for device in devices:
                device.send()
            next_step_s = begin_s + (clock.time_s + STEP_S) / speed
            next_s = min(max(next_step_s, now_s + _WAKE_MIN_S), *(port.next_s for port in ports.values()))
            wake_s = max(0.0, next_s - time.monotonic())
            of_devices = {listening: device for device in devices for listening in device.sockets}
            for ready in select.select([*ports, *of_devices], [], [], wake_s)[0]:
                (ports[ready] if ready in ports else of_devices[ready]).receive()

"""The simulation behind a UDP socket, paced by the wall clock."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence

import numpy as np

from sitl.link import FaultyLink, LinkFaults
from sitl.simulation import STEP_S, Simulation

Address = tuple[str, int]

_WAKE_MIN_S = 0.004
_LAG_MAX_S = 0.25  # of the wall clock; further behind, the simulation goes slower instead of catching up
_DATAGRAM_MAX = 4096
_LINK_STREAM = 2  # of the seed's children: 0 and 1 are the target's and the sensors'


def serve(
    simulation: Simulation,
    stations: Sequence[Address],
    *,
    speed: float = 1.0,
    duration_s: float = float("inf"),
    faults: LinkFaults | None = None,
    on_ready: Callable[[], None] = lambda: None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Fly until ``stopped`` or for duration_s, sending to ``stations`` and to whoever speaks to the socket.

    speed is simulated over wall time.
    """
    seed = np.random.SeedSequence(simulation.settings.seed, spawn_key=(_LINK_STREAM,))
    out_rng, in_rng = (np.random.default_rng(child) for child in seed.spawn(2))
    outward: FaultyLink[tuple[Address, bytes]] = FaultyLink(faults or LinkFaults(), out_rng)
    inward: FaultyLink[tuple[Address, bytes]] = FaultyLink(faults or LinkFaults(), in_rng)
    loopback = all(host.startswith("127.") for host, _ in stations)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1" if loopback else "", 0))
        udp.setblocking(False)
        for address in stations:
            simulation.connect(address)
        on_ready()
        begin_s = time.monotonic() - simulation.time_s / speed
        while simulation.time_s < duration_s and not stopped():
            now_s = time.monotonic()
            goal_s = (now_s - begin_s) * speed
            lag_s = goal_s - simulation.time_s - _LAG_MAX_S * speed
            if lag_s > 0.0:
                begin_s += lag_s / speed
                goal_s -= lag_s
            simulation.advance(min(goal_s, duration_s))
            for address, data in inward.take(now_s):
                simulation.receive(address, data)
            _send(udp, simulation, outward, now_s)
            next_step_s = begin_s + (simulation.time_s + STEP_S) / speed
            next_s = min(max(next_step_s, now_s + _WAKE_MIN_S), inward.next_s, outward.next_s)
            wake_s = max(0.0, next_s - time.monotonic())
            if select.select([udp], [], [], wake_s)[0]:
                _receive(udp, inward)


def _receive(udp: socket.socket, inward: FaultyLink[tuple[Address, bytes]]) -> None:
    now_s = time.monotonic()
    while True:
        try:
            data, address = udp.recvfrom(_DATAGRAM_MAX)
        except BlockingIOError:
            return
        except ConnectionError:
            continue  # a station has gone; the next datagram may be another's
        inward.put((address, data), now_s)


def _send(
    udp: socket.socket, simulation: Simulation, outward: FaultyLink[tuple[Address, bytes]], now_s: float
) -> None:
    for datagram in simulation.take():
        outward.put(datagram, now_s)  # type: ignore[arg-type]  # this shell's stations are UDP addresses
    for address, data in outward.take(now_s):
        try:
            udp.sendto(data, address)
        except (BlockingIOError, ConnectionError):
            continue  # as lost as on the air

"""The closed loop over faulty links: loss, delay, jitter, duplicates, silences, and faults of single packets."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from sidelong.app.link.message import Message
from sidelong.app.simulation.kinematic import KinematicVehicle
from sidelong.app.simulation.loop import ClosedLoop, SimulatedVehicle
from sidelong.sitl.server import FaultyLink
from sidelong.sitl.settings import LinkFaults

P = TypeVar("P")
NO_FAULTS = LinkFaults()

Change = Callable[[P, float], Iterable[tuple[float, P]]]
"""Returns what becomes of a packet that is sent at a time: copies, each with its delay in seconds."""


@dataclass(frozen=True, slots=True)
class Silence:
    """A time in which nothing comes through, in seconds of the link's clock."""

    begin_s: float
    end_s: float


class Link(Generic[P]):
    """Carries packets one way, of any kind; a packet that is sent twice or late comes out of ``take`` so.

    Args:
        faults: loss, duplicates, delay, jitter and baud rate.
        rng: randomness of the faults.
        silences: when nothing comes through.
        change: what becomes of each packet before it meets the link; None: nothing.
    """

    def __init__(
        self,
        faults: LinkFaults,
        rng: np.random.Generator,
        silences: tuple[Silence, ...] = (),
        change: Change[P] | None = None,
    ) -> None:
        self._link: FaultyLink[P] = FaultyLink(faults, rng)
        self._is_perfect = faults == NO_FAULTS
        self._silences, self._change = silences, change
        self._held_up: list[tuple[float, int, P]] = []  # by a change
        self._count = itertools.count()
        self._at_once: list[P] = []  # of a link without faults

    @property
    def faults(self) -> LinkFaults:
        """The faults of what is sent from now on."""
        return self._link.faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._link.faults = faults
        self._is_perfect = faults == NO_FAULTS

    def put(self, packet: P, now_s: float, size_bytes: int = 0) -> None:
        """Send a packet."""
        if self._silences and any(one.begin_s <= now_s < one.end_s for one in self._silences):
            return
        if self._change is None:
            self._send(packet, now_s, size_bytes)
            return
        for delay_s, changed in self._change(packet, now_s):
            if delay_s > 0.0:
                heapq.heappush(self._held_up, (now_s + delay_s, next(self._count), changed))
            else:
                self._send(changed, now_s, size_bytes)

    def take(self, now_s: float) -> list[P]:
        """Return what has arrived by now, in the order of arrival."""
        taken, self._at_once = self._at_once, []
        taken += self._link.take(now_s)
        while self._held_up and self._held_up[0][0] <= now_s:
            taken.append(heapq.heappop(self._held_up)[2])
        return taken

    def _send(self, packet: P, now_s: float, size_bytes: int) -> None:
        if self._is_perfect and self._link.next_s == math.inf:  # nothing that was sent before is still under way
            self._at_once.append(packet)
        else:
            self._link.put(packet, now_s, size_bytes)


class FaultyLoop(ClosedLoop[P]):
    """A closed loop over links.

    Args:
        simulated: the vehicle, and what it carries.
        down: the link from the vehicle.
        up: the link to the vehicle.
        rate: seconds of the vehicle's clock in one of the link's.
    """

    def __init__(
        self,
        simulated: SimulatedVehicle[P],
        down: Link[P] | None = None,
        up: Link[bytes] | None = None,
        rate: float = 1.0,
    ) -> None:
        super().__init__(simulated)
        unused = np.random.default_rng(0)
        self.down: Link[P] = down or Link(NO_FAULTS, unused)
        self.up: Link[bytes] = up or Link(NO_FAULTS, unused)
        self.rate = rate

    @property
    def link_s(self) -> float:
        return super().link_s / self.rate

    def step(self) -> None:
        for frame in self.up.take(self.link_s):
            self.deliver(frame)
        super().step()

    def deliver(self, frame: bytes) -> None:
        """Hand the vehicle a frame that has come through."""
        self.simulated.receive(frame)

    def arriving(self) -> Iterable[P]:
        link_s = self.link_s
        for packet in super().arriving():
            self.down.put(packet, link_s, len(packet) if isinstance(packet, bytes) else 0)
        return self.down.take(link_s)

    def transmit(self, frame: bytes) -> None:
        self.up.put(frame, self.link_s, len(frame))


class MessagingVehicle(KinematicVehicle):
    """A kinematic vehicle whose position and attitude come as messages, too, so that faults can change them."""

    def position(self, boot_ms):
        craft, home = self.craft, self._start.home
        latitude_deg, longitude_deg = self._start.plane.latitude_longitude_deg(craft.east_m, craft.north_m)
        fields = {
            "time_boot_ms": boot_ms,
            "lat": round(latitude_deg * 1e7),
            "lon": round(longitude_deg * 1e7),
            "alt": round((home.altitude_m + craft.height_m) * 1000.0),
            "relative_alt": round(craft.height_m * 1000.0),
            "vx": round(craft.velocity_north_m_s * 100.0),
            "vy": round(craft.velocity_east_m_s * 100.0),
            "vz": round(craft.climb_m_s * -100.0),
        }
        return Message("GLOBAL_POSITION_INT", self.system_id, 1, fields, 0.0)

    def attitude(self, boot_ms):
        own = super().attitude(boot_ms)
        fields = {"time_boot_ms": boot_ms, "roll": own.roll_rad, "pitch": own.pitch_rad, "yaw": own.yaw_rad}
        return Message("ATTITUDE", self.system_id, 1, fields, 0.0)

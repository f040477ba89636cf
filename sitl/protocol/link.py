"""A bad radio link: it drops, delays, duplicates and reorders datagrams, and has a limited data rate."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Annotated, Generic, TypeVar

import numpy as np
from pydantic import Field

T = TypeVar("T")

_BUFFER_BYTES = 4096  # of a slow line; what comes when it is full is lost
_BITS_PER_BYTE = 10  # with start and stop bit


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """Faults of a link, in each direction."""

    loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # fraction
    duplicate: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # fraction of the datagrams that are not lost
    delay_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0  # of the stations' clock
    jitter_s: float = 0.0  # maximum additional delay, drawn for each datagram: datagrams overtake each other
    # Of a serial line: what it cannot carry is late, then lost.
    baud: Annotated[float, Field(ge=1200.0)] = float("inf")


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
        taken = []
        while self._waiting and self._waiting[0][0] <= now_s:
            taken.append(heapq.heappop(self._waiting)[2])
        return taken

    @property
    def next_s(self) -> float:
        """When the next one comes out; infinity if none waits."""
        return self._waiting[0][0] if self._waiting else float("inf")

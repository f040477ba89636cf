"""The links' measures written down while flying: a row a second for each link."""

from __future__ import annotations

import asyncio
import contextlib
import csv
import io
import math
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from sidelong.app.link.vehicle import Link
from sidelong.app.records.appender import Appender

_EVERY_S = 1.0
_RATE_MAX = 200.0  # no simulation is faster
COLUMNS = (
    *("time_s", "url", "in_use", "silent_s", "loss", "round_trip_s", "received_bytes_s", "sent_bytes_s"),
    *("rssi", "remote_rssi", "refused"),
)


class ClockRate:
    """How many seconds of the vehicle's clock, ``now_s``, go by in one of ours: ten in a fast simulation."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.now_s = now_s
        self._latest_s = math.nan, math.nan  # of both clocks
        self._elapsed_s = [0.0, 0.0]

    def look(self, ours_s: float) -> None:
        """Compare the clocks; a step of the vehicle's clock is left out."""
        both_s = self.now_s(), ours_s
        vehicle_s, wall_s = (now_s - latest_s for now_s, latest_s in zip(both_s, self._latest_s, strict=True))
        self._latest_s = both_s
        if wall_s > 0.0 and 0.0 < vehicle_s < _RATE_MAX * wall_s:
            self._elapsed_s[0] += vehicle_s
            self._elapsed_s[1] += wall_s

    @property
    def mean(self) -> float:
        """What it was since the first look."""
        return self._elapsed_s[0] / self._elapsed_s[1] if self._elapsed_s[1] else 1.0


@contextlib.asynccontextmanager
async def link_log(
    link: Link, path: Path, clock_rate: ClockRate, on_trouble: Callable[[str], None]
) -> AsyncIterator[None]:
    """Log link statistics to ``path`` inside the context; update clock_rate: rates refer to the vehicle's clock.

    A file that cannot be begun is reported, and the flight goes on without it.
    """
    try:
        file = Appender(path, on_trouble, _line(COLUMNS))
    except OSError as error:
        on_trouble(f"{path} cannot be written ({error.strerror}). The flight goes on without this record.")
        yield
        return
    with file:

        async def write() -> None:
            while True:
                await asyncio.sleep(_EVERY_S)
                clock_rate.look(time.monotonic())
                for report in link.recent():
                    values = report.as_json(clock_rate.mean) | {
                        "time_s": round(clock_rate.now_s(), 2),
                        "in_use": int(report.in_use),
                        "refused": sum(report.refused.values()),
                    }
                    file.append(_line([values[column] for column in COLUMNS]))

        writing = asyncio.create_task(write())
        try:
            yield
        finally:
            writing.cancel()
            await asyncio.gather(writing, return_exceptions=True)


def _line(values: Sequence[object]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(values)
    return text.getvalue().encode()

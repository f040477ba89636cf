"""The links' measures written down while flying: a row a second for each link."""

from __future__ import annotations

import asyncio
import contextlib
import csv
import io
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from app.flight.recording import beginning
from app.link.link import Link
from app.records.appender import Appender

_EVERY_S = 1.0
COLUMNS = (
    *("time_s", "url", "in_use", "silent_s", "loss", "round_trip_s", "received_bytes_s", "sent_bytes_s"),
    *("rssi", "remote_rssi", "refused"),
)


@contextlib.asynccontextmanager
async def link_log(
    link: Link, path: Path, now_s: Callable[[], float], on_trouble: Callable[[str], None]
) -> AsyncIterator[None]:
    """Write the links' measures to ``path`` meanwhile. now_s is the vehicle's clock."""
    with beginning(path.parent):
        file = Appender(path, on_trouble, _line(COLUMNS))
    with file:

        async def write() -> None:
            while True:
                await asyncio.sleep(_EVERY_S)
                for report in link.recent():
                    values = report.as_json() | {
                        "time_s": round(now_s(), 2),
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

"""Reports to systemd that the service is ready, what it does, and that it is alive (sd_notify)."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket

_SHARE = 3.0  # of the watchdog's period, between two signs of life


def notify(*assignments: str) -> None:
    """Send assignments such as READY=1 to the service manager, if there is one."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.setblocking(False)
        manager.sendto("\n".join(assignments).encode(), address)


async def feed_watchdog() -> None:
    """Give signs of life from the event loop until cancelled, so that the manager restarts one that hangs."""
    period_us = os.environ.get("WATCHDOG_USEC", "")
    if not period_us.isdigit() or os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return
    while True:
        notify("WATCHDOG=1")
        await asyncio.sleep(int(period_us) * 1e-6 / _SHARE)

"""The page's process: started, spoken to in lines without ever waiting for it, and sent what all pages need."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import select
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence

from sidelong.app.errors import InputError
from sidelong.app.process import helper_command, helper_environment
from sidelong.app.view.address import PageAddress
from sidelong.app.view.history import Json
from sidelong.app.view.shading import PictureFile, Shading

_UP_S = 30.0  # a second or two; a machine that is busy takes many times that
_END_S = 2.0


class FeedError(Exception):
    """The process did not come up; the text is its own complaint."""


class Feed:
    """Starts ``command``; ``send`` and ``lines`` return at once whatever the process does."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        # A session of its own keeps the terminal's Ctrl-C from ending it before the flight has ended.
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115  # closed by close(); a pipe could fill up
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            env=environment,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)
        self._unsent = b""
        self._unread = b""
        self.alive = True

    def send(self, line: bytes) -> bool:
        """Send a line (without its end); False, and nothing sent, while the pipe is full or the process gone."""
        self.flush()
        if self._unsent or not self.alive:
            return False
        self._unsent = line + b"\n"
        self.flush()
        return self.alive

    @property
    def ready(self) -> bool:
        """Whether the last line has gone out whole, so that the next would be taken."""
        self.flush()
        return self.alive and not self._unsent

    def flush(self) -> None:
        """Write the waiting lines, as many as the pipe takes now."""
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[os.write(self._in, self._unsent) :]
        except BlockingIOError:
            return
        except OSError:
            self.alive = False

    def lines(self) -> list[bytes]:
        """Return the requests that the page has sent since the last call, one line of JSON each."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._out, 65536):
                self._unread += data
            self.alive = False
        *whole, self._unread = self._unread.split(b"\n")
        return whole

    def wait_for_line(self, timeout_s: float) -> bytes:
        """Return the first line, for which the process is given ``timeout_s``. Raises FeedError."""
        deadline_s = time.monotonic() + timeout_s
        while (remaining_s := deadline_s - time.monotonic()) > 0.0:
            select.select([self._out], [], [], remaining_s)
            lines = self.lines()
            if lines:
                return lines[0]
            if not self.alive:
                break
        self._process.kill()
        self._process.wait()
        self._complaints.seek(0)
        complaint = self._complaints.read().decode(errors="replace").strip().splitlines()
        self.close()
        raise FeedError(complaint[-1] if complaint else f"it was not ready within {timeout_s:g} s")

    def close(self) -> None:
        self.alive = False
        for stream in (self._process.stdin, self._process.stdout, self._complaints):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def start_page(
    address: PageAddress, replay: bool = False, fleet: Sequence[str] = (), service: bool = False
) -> tuple[Feed, str, str]:
    """Start the server and wait for it; return the feed to it and the URLs for the operator and for viewers.

    Raises InputError when it does not start, for example because the port is in use.
    """
    host, port, under = address.host, address.port, address.map
    token, viewer_token = ("", "") if address.is_local else (secrets.token_urlsafe(16), secrets.token_urlsafe(16))
    feed = Feed(helper_command("sidelong.app.view.server"), helper_environment())
    options: Json = {"host": host, "port": port, "operator_token": token, "viewer_token": viewer_token}
    options["map"] = under and {"path": str(under.path.absolute()), "zooms": under.zooms}
    options |= {"cert": address.cert and str(address.cert), "key": address.key and str(address.key)}
    options |= {"replay": replay, "fleet": list(fleet), "service": service}
    feed.send(page_line(options))
    try:
        ready = json.loads(feed.wait_for_line(_UP_S))
    except FeedError as error:
        raise InputError(f"the page cannot be shown on {host}:{port}: {error}; try another --view-port.") from error
    url = f"{address.scheme}://{host}:{ready['port']}/"
    return (feed, f"{url}?token={token}", f"{url}?token={viewer_token}") if token else (feed, url, url)


def under_flight(address: PageAddress, shading: Shading | None, pictures: PictureFile | None) -> Json:
    """Return what the page shows below a flight: map tiles, hill shading, and whether there is a camera."""
    under = address.map
    layers = None if under is None else {"zooms": under.zooms, "bounds_deg": under.bounds_deg}
    shade_m = None if shading is None else shading.edges_m
    return {"map": layers, "shade_m": shade_m, "camera": pictures is not None}


def page_line(values: Json) -> bytes:
    """Return values as a line of the pipe to the page's process."""
    return json.dumps(values, separators=(",", ":"), allow_nan=False).encode()

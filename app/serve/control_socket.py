"""The local socket by which ``status``, ``watch`` and ``release`` speak with the service: one JSON line each way.

A Unix domain socket has an owner and a mode, so no token is needed and no other computer reaches it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import tempfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from sidelong.app.errors import InputError

REQUESTS = ("status", "watch", "release")
_NAME = "sidelong/serve.sock"
_LINE_MAX_BYTES = 4096
_ANSWER_S, _REQUEST_S = 10.0, 5.0
_OF_SYSTEM = Path("/run") / _NAME

Answer = Callable[[str], dict[str, Any]]


def own_path() -> Path:
    """Return where a service of this user has its socket."""
    given, runtime = os.environ.get("SIDELONG_SOCKET"), os.environ.get("RUNTIME_DIRECTORY")
    if given:
        return Path(given)
    if runtime:  # of systemd, which names it
        return Path(runtime.split(":")[0]) / Path(_NAME).name
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user or Path(tempfile.gettempdir()) / f"sidelong-{os.getuid()}") / _NAME


def _candidates() -> list[Path]:
    return [own_path()] if os.environ.get("SIDELONG_SOCKET") else [own_path(), _OF_SYSTEM]


@contextlib.asynccontextmanager
async def serving(path: Path, answer: Answer) -> AsyncIterator[None]:
    """Answer requests inside the context; ``answer`` gets the request and returns the answer's fields.

    Raises InputError where another service is there already, or the socket cannot be made.
    """

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, TimeoutError, ValueError):
            line = await asyncio.wait_for(reader.readline(), _REQUEST_S)
            writer.write(json.dumps(_answered(line, answer)).encode() + b"\n")
            await asyncio.wait_for(writer.drain(), _REQUEST_S)
        writer.close()

    try:
        path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
        if path.is_socket():
            if _is_served(path):
                raise InputError(f"{path}: another sidelong serve runs; end it first, or set SIDELONG_SOCKET.")
            path.unlink()  # of one that was killed
        before = os.umask(0o117)  # for its owner and group
        try:
            server = await asyncio.start_unix_server(converse, path, limit=_LINE_MAX_BYTES)
        finally:
            os.umask(before)
    except OSError as error:
        raise InputError(
            f"{path}: the control socket cannot be made ({error.strerror}); set SIDELONG_SOCKET."
        ) from error
    try:
        yield
    finally:
        server.close()
        with contextlib.suppress(OSError):
            path.unlink()


def _answered(line: bytes, answer: Answer) -> dict[str, Any]:
    try:
        request = json.loads(line)["request"]
    except (ValueError, KeyError, TypeError, RecursionError):
        request = None
    if request not in REQUESTS:
        return {"accepted": False, "text": f"a request is one of {', '.join(REQUESTS)}"}
    return answer(request)


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as client:
        try:
            client.connect(str(path))
        except OSError:
            return False
    return True


def ask(request: str) -> dict[str, Any]:
    """Return the service's answer. Raises InputError where none runs, or it does not answer."""
    error: OSError | None = None
    for path in _candidates():
        try:
            return _asked(path, request)
        except PermissionError as refused:
            error = refused
            break
        except OSError as failed:
            error = error or failed
    why = "may not be used by this user" if isinstance(error, PermissionError) else "does not answer"
    raise InputError(f"{path}: sidelong serve {why}; start it with: sidelong serve.") from error


def _asked(path: Path, request: str) -> dict[str, Any]:
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(_ANSWER_S)
        client.connect(str(path))
        client.sendall(json.dumps({"request": request}).encode() + b"\n")
        with client.makefile("rb") as answer:
            line = answer.readline(1 << 16)
    try:
        answered = json.loads(line)
    except ValueError as error:
        raise OSError("the answer is damaged") from error
    if not isinstance(answered, dict):
        raise OSError("the answer is damaged")
    return answered

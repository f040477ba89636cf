"""The local socket by which ``status``, ``watch`` and ``release`` speak with the service: one JSON line each way.

A Unix domain socket has an owner and a mode, so no token is needed and no other computer reaches it. A path is not
trusted: each side asks the kernel which account is at the other end.
"""

from __future__ import annotations

import asyncio
import contextlib
import grp
import json
import os
import pwd
import socket
import stat
import struct
from collections import Counter
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from sidelong.app.errors import InputError

REQUESTS = ("status", "watch", "release", "confirm")
_NAME = "sidelong/serve.sock"
_LINE_MAX_BYTES = 4096
_ANSWER_S, _REQUEST_S = 10.0, 5.0
_CONVERSATIONS_MAX = 8  # of one account at a time
_OF_SYSTEM = Path("/run") / _NAME

Answer = Callable[[str], dict[str, Any]]


def own_path() -> Path:
    """Return where this user's service has its socket: SIDELONG_SOCKET, systemd's runtime folder, or the user's."""
    given, runtime = os.environ.get("SIDELONG_SOCKET"), os.environ.get("RUNTIME_DIRECTORY")
    if given:
        return Path(given)
    if runtime:  # of systemd, which names it
        return Path(runtime.split(":")[0]) / Path(_NAME).name
    user = Path(os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}")
    if _is_of(user, {os.getuid()}):
        return user / _NAME
    return Path.home() / ".local/state" / _NAME


def _is_of(folder: Path, accounts: set[int]) -> bool:
    """Return whether a folder belongs to one of the accounts, and others cannot put anything into it."""
    try:
        found = folder.stat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid in accounts and not found.st_mode & stat.S_IWOTH


@contextlib.asynccontextmanager
async def serving(path: Path, answer: Answer) -> AsyncIterator[None]:
    """Answer requests inside the context; ``answer`` gets the request and returns the answer's fields.

    Raises InputError where another service is there already, or the socket cannot be made.
    """
    talking: Counter[int] = Counter()

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        account, group = _peer(writer.get_extra_info("socket"))
        talking[account] += 1
        with contextlib.suppress(OSError, TimeoutError, ValueError):
            if talking[account] <= _CONVERSATIONS_MAX and _may_ask(account, group, path):
                line = await asyncio.wait_for(reader.readline(), _REQUEST_S)
                writer.write(json.dumps(_answered(line, answer)).encode() + b"\n")
                await asyncio.wait_for(writer.drain(), _REQUEST_S)
        talking[account] -= 1
        writer.close()

    try:
        if os.environ.get("SIDELONG_SOCKET") and not path.parent.parent.is_dir():
            raise InputError(f"SIDELONG_SOCKET: there is no folder {path.parent.parent}; create it, or name another.")
        path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
        if not _is_of(path.parent, {0, os.getuid()}):
            raise InputError(f"{path.parent}: others can write there; set SIDELONG_SOCKET to a folder of your own.")
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


def _peer(connection: socket.socket) -> tuple[int, int]:
    _, account, group = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return account, group


def _may_ask(account: int, group: int, path: Path) -> bool:
    if account in (0, os.getuid()):
        return True
    owners = path.stat().st_gid
    with contextlib.suppress(KeyError):  # an account without a name has the group of its process alone
        return owners == group or pwd.getpwuid(account).pw_name in grp.getgrgid(owners).gr_mem
    return owners == group


def _is_the_service(account: int, path: Path) -> bool:
    """Return whether the account that answers at a path is ours or the system's, or owns a folder made by root."""
    if account in (0, os.getuid()):
        return True
    folder = path.parent
    return _is_of(folder.parent, {0}) and _is_of(folder, {account})


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as client:
        try:
            client.connect(str(path))
        except OSError:
            return False
        return _is_the_service(_peer(client)[0], path)


def ask(request: str) -> dict[str, Any]:
    """Return the service's answer. Raises InputError where none runs, it does not answer, or another account does."""
    error: OSError | None = None
    for path in (own_path(),) if os.environ.get("SIDELONG_SOCKET") else (own_path(), _OF_SYSTEM):
        try:
            return _asked(path, request)
        except PermissionError as refused:
            error = refused
            break
        except OSError as failed:
            error = error or failed
    why = "may not be used by this user" if isinstance(error, PermissionError) else "does not answer"
    if isinstance(error, _ForeignError):
        why = f"does not answer; {error}"
    raise InputError(f"{path}: sidelong serve {why}; start it with: sidelong serve.") from error


class _ForeignError(OSError):
    """Another account answers at a path."""


def _asked(path: Path, request: str) -> dict[str, Any]:
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(_ANSWER_S)
        client.connect(str(path))
        account = _peer(client)[0]
        if not _is_the_service(account, path):
            raise _ForeignError(f"the account with the number {account} listens at {path}")
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

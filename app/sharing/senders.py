"""Non-blocking senders of small messages: a message that the network does not accept is dropped."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress

_CONNECT_TIMEOUT_S, _AGAIN_AFTER_S = 10.0, 5.0
_BACKLOG_MAX_BYTES = 64 << 10


class Sender(Protocol):
    def send(self, data: bytes) -> None: ...

    def stop(self) -> None: ...


class DatagramSender:
    """Sends by UDP. Raises InputError, naming ``name``, for a host that is not known."""

    def __init__(self, address: NetworkAddress, name: str) -> None:
        self._to = address.resolved(name)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._to)

    def stop(self) -> None:
        self._socket.close()


class StreamSender:
    """Sends by TCP or TLS and reconnects automatically; create it in the running event loop.

    It reads and discards incoming data, because a server forwards the messages of its other clients. It announces
    when the connection is established and when it is lost.
    """

    def __init__(
        self,
        address: NetworkAddress,
        tls: ssl.SSLContext | None,
        server_name: str | None,
        announce: Callable[[str], None],
    ) -> None:
        self._address, self._tls, self._announce = address, tls, announce
        self._server_name = (server_name or address.host) if tls is not None else None
        self._writer: asyncio.StreamWriter | None = None
        self._announced = ""
        self._task = asyncio.create_task(self._run())

    def send(self, data: bytes) -> None:
        writer = self._writer
        if writer is not None and writer.transport.get_write_buffer_size() < _BACKLOG_MAX_BYTES:
            writer.write(data)

    def stop(self) -> None:
        self._task.cancel()

    async def _run(self) -> None:
        where = f"{self._address.scheme}://{self._address.host}:{self._address.port}"
        while True:
            try:
                await self._connected(where)
                self._announce_once(f"{where} has closed the connection; trying again")
            except (OSError, TimeoutError) as error:
                self._announce_once(f"{where} cannot be reached ({_reason(error)}); trying again")
            await asyncio.sleep(_AGAIN_AFTER_S)

    async def _connected(self, where: str) -> None:
        host, port = self._address.host, self._address.port
        opening = asyncio.open_connection(host, port, ssl=self._tls, server_hostname=self._server_name)
        reader, writer = await asyncio.wait_for(opening, _CONNECT_TIMEOUT_S)
        self._writer = writer
        self._announce_once(f"sending to {where}")
        try:
            while await reader.read(_BACKLOG_MAX_BYTES):
                pass
        finally:
            self._writer = None
            writer.close()

    def _announce_once(self, text: str) -> None:
        if text != self._announced:
            self._announced = text
            self._announce(text)


def tls_context(certificate: Path | None, key: Path | None, authority: Path | None, name: str) -> ssl.SSLContext:
    """Return a client's TLS context: its certificate and key, and the trusted authorities (None: the system's).

    Raises InputError, beginning with ``name``, for files that do not serve.
    """
    try:
        context = ssl.create_default_context(cafile=authority)
        if authority is not None:
            # Since Python 3.13 a certificate must state its key usage; those of private authorities rarely do.
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        raise InputError(
            f"{name}: {authority} holds no certificates ({_reason(error)}); give a PEM file in {name}_authority_file."
        ) from error
    if certificate is not None:
        try:
            context.load_cert_chain(certificate, key, password=lambda: _refused(name))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{name}: {certificate} and its key cannot be used ({_reason(error)}); give PEM files in "
                f"{name}_certificate_file and {name}_key_file."
            ) from error
    elif key is not None:
        raise InputError(f"{name}: {key} is given without its certificate; give {name}_certificate_file.")
    return context


def _refused(name: str) -> str:
    raise InputError(f"{name}: the key is protected by a password; remove it with openssl pkey -in KEY -out NEW.")


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer"
    if isinstance(error, ssl.SSLError):
        return str(getattr(error, "verify_message", "") or error.reason or "TLS failed")
    return str(getattr(error, "strerror", None) or error or error.__class__.__name__)

"""``python -m app.view``: serves the page; states come in on standard input, buttons go out on standard output.

The first line in is {"host", "port", "operator_token", "viewer_token", "cert", "key", "map", "replay",
"fleet", "service"}, the first line out {"port"}. It ends when its input does.
"""

from __future__ import annotations

import asyncio
import json
import socket
import sys
from pathlib import Path

import uvicorn

from sidelong.app.view.access import Access
from sidelong.app.view.background import Background
from sidelong.app.view.guard import Listener
from sidelong.app.view.history import Json
from sidelong.app.view.server import Server

_LINE_MAX_BYTES = 1 << 22


def _listening(host: str, port: int) -> Listener:
    listener = Listener(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()  # from here on a browser may come: it waits until the server runs
    except OSError as error:
        sys.exit(f"port {port} cannot be opened ({error.strerror})")
    return listener


async def _serve() -> None:
    reader = asyncio.StreamReader(_LINE_MAX_BYTES)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    options = json.loads(await reader.readline())
    listener = _listening(options["host"], options["port"])

    def press(pressed: Json) -> None:
        print(json.dumps(pressed), flush=True)

    under = options["map"] and Background(Path(options["map"]["path"]), zooms=options["map"]["zooms"])
    access = Access(options["host"], options["operator_token"], options["viewer_token"])
    server = Server(access, press, under, options["replay"], options["fleet"], options["service"])
    configured = uvicorn.Config(
        server.app,
        http="h11",
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,  # the client address is that of the connection
        timeout_keep_alive=30,  # a page on a stalled line comes again on the connection that it has
        timeout_graceful_shutdown=1,
        ssl_certfile=options["cert"],
        ssl_keyfile=options["key"],
    )
    try:
        configured.load()
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        sys.exit(f"the certificate or its key cannot be used ({error})")
    runner = uvicorn.Server(configured)
    serving = asyncio.create_task(runner.serve(sockets=[listener]))
    print(json.dumps({"port": listener.getsockname()[1]}), flush=True)
    while (line := await reader.readline()).endswith(b"\n"):  # a cut line is the end, too
        server.publish(json.loads(line))
    server.close()
    runner.should_exit = True
    await serving


asyncio.run(_serve())

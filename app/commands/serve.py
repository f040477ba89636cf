"""``sidelong serve``: the resident form of ``launch``; ``status``, ``watch`` and ``release`` speak with it."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sidelong.app.commands.options import MAP, SetOption, changed_keys
from sidelong.app.commands.output import JsonOption, checked_output, say, shielded_output, write_json
from sidelong.app.config import Config, load_config
from sidelong.app.config_files import check_single
from sidelong.app.errors import FlightError, InputError
from sidelong.app.link.message import plain
from sidelong.app.link.transport import checked_url
from sidelong.app.serve.control_socket import ask, own_path
from sidelong.app.view.address import PageAddress, page_address

if TYPE_CHECKING:
    from sidelong.app.flight.loop import FlightDisplay
    from sidelong.app.serve.resident import ServiceDisplay


def serve(
    config: Annotated[Path | None, typer.Argument(help="Configuration (TOML).")] = None,
    connect: Annotated[list[str] | None, typer.Option(help="MAVSDK URL of the vehicle, instead of link.url.")] = None,
    view: Annotated[bool, MAP("--view", help="Serve a live map while a watch lasts.")] = False,
    set_: SetOption = None,
    out: Annotated[Path, typer.Option(help="Where run folders are made.")] = Path("runs"),
) -> None:
    """Wait for the vehicle and watch on request; made to run on board without a terminal, as a system service.

    A watch begins, is resumed after a pilot took over, and ends by `sidelong watch` and `sidelong release`, by a
    switch of the transmitter, a flight mode or a command of the ground station (section [control]). Each watch has a
    run folder of its own; the oldest ones are deleted beyond the disk budget.

    For example:
      sidelong serve mission.toml --connect udpin://127.0.0.1:14540
      sidelong status
      sidelong watch
    """
    settings = load_config(config, changed_keys(set_, {"link": {"urls": connect or None}}))
    if not settings.link.connections:
        raise InputError("sidelong serve needs a vehicle; give --connect URL, or link.url in the configuration.")
    for url in settings.link.connections:
        checked_url(url)
    check_single(settings)
    address = page_address(view, settings.display)
    # The flight modules take a second to load; report a wrong option first.
    from sidelong.app.process import run  # noqa: PLC0415
    from sidelong.app.serve.resident import Resident, share_one_heap, undecorated  # noqa: PLC0415

    share_one_heap()

    def log(text: str) -> None:
        say(plain(text))

    obstacle = "" if address is None else address.obstacle
    if address is not None and obstacle:  # its network may come up later
        where = f"{address.host}:{address.port}"
        log(f"the live map cannot be served at {where} now ({obstacle}); watches go on without it")

    async def live() -> None:
        loop, stopped = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, stopped.set)
        shown = undecorated if address is None else partial(_on_map, settings, address, log)
        resident = Resident(settings, out, partial(_from_any_thread, loop, log), shown)
        await resident.run(stopped, own_path())
        log("sidelong serve has ended; an aircraft in flight goes on with what it flies")

    with shielded_output():
        run(live())


@contextlib.asynccontextmanager
async def _on_map(
    settings: Config, address: PageAddress, log: Callable[[str], object], display: ServiceDisplay
) -> AsyncIterator[FlightDisplay]:
    """Show a watch on the live map too. A watch goes on without a map that cannot be served."""
    from sidelong.app.view.display import ViewDisplay, served  # noqa: PLC0415  # as above

    async with contextlib.AsyncExitStack() as stack:
        shown: FlightDisplay = display
        try:
            shown = await stack.enter_async_context(served(ViewDisplay({"": display}, {"": settings}, address), log))
        except InputError as error:
            log(f"the watch goes on without the live map: {error}")
        yield shown


def _from_any_thread(loop: asyncio.AbstractEventLoop, log: Any, text: str) -> None:
    try:
        asyncio.get_running_loop()
        log(text)
    except RuntimeError:
        loop.call_soon_threadsafe(log, text)


def status(json: JsonOption = None) -> None:
    """Print what sidelong serve does now: waiting, ready, watching, yielded or fault.

    For example:
      sidelong status
      sidelong status --json -
    """
    checked_output(json)
    answer = ask("status")
    if json is None or str(json) != "-":
        reported = answer["status"]
        say(plain(answer["text"]))
        for name in ("vehicle", "run", "records"):
            if reported[name]:
                say(plain(f"{name}: {reported[name]}"))
    write_json(json, answer["status"])


def watch() -> None:
    """Ask sidelong serve to watch: begin, or resume after a pilot took over. The vehicle is checked first.

    On the ground the aircraft arms and takes off.

    For example:
      sidelong watch
    """
    _ask("watch")


def release() -> None:
    """Ask sidelong serve to end the watch; the aircraft goes on with what it flies.

    For example:
      sidelong release
    """
    _ask("release")


def _ask(request: str) -> None:
    answer = ask(request)
    text = f"{answer['text']}".rstrip(".")
    if not answer["accepted"]:
        raise FlightError(f"{request} refused: {text}.")
    say(plain(text))

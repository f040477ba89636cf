"""``sidelong serve``: the resident form of ``launch``; ``status``, ``watch`` and ``release`` speak with it."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sidelong.app.commands.options import MAP, ConfigArgument, SetOption, changed_keys
from sidelong.app.commands.output import JsonOption, checked_output, say, shielded_output, write_json
from sidelong.app.config import Config, load_config
from sidelong.app.config_files import check_single
from sidelong.app.errors import FlightError, InputError
from sidelong.app.link.message import plain
from sidelong.app.link.transport import checked_url
from sidelong.app.process import program
from sidelong.app.serve.control_socket import ask, own_path
from sidelong.app.view.address import PageAddress, page_address

if TYPE_CHECKING:
    from sidelong.app.flight.loop import FlightDisplay
    from sidelong.app.serve.resident import Resident, ServiceDisplay


def serve(
    config: ConfigArgument = None,
    connect: Annotated[list[str] | None, typer.Option(help="MAVSDK URL of the vehicle, instead of link.url.")] = None,
    view: Annotated[bool, MAP("--view", help="Serve the live map, which begins and ends watches, too.")] = False,
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
    from sidelong.app.serve.resident import Resident, share_one_heap  # noqa: PLC0415

    share_one_heap()

    async def live() -> None:
        loop, stopped = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, stopped.set)
        async with contextlib.AsyncExitStack() as stack:
            page = None if address is None else ServicePage(settings, address, stack)
            log = say_plain if page is None else page.log
            own = settings, out, partial(_from_any_thread, loop, log)
            resident = Resident(*own) if page is None else Resident(*own, page.decorate, page.draw)
            if page is not None:
                await page.open(resident)
            log(f"`{program()} watch`, the live map or a switch begins a watch; control socket: {own_path()}")
            await resident.run(stopped, own_path())
        say_plain("sidelong serve has ended; an aircraft in flight goes on with what it flies")

    with shielded_output():
        run(live())


def say_plain(text: str) -> None:
    """Print a text without its control characters."""
    say(plain(text))


class ServicePage:
    """The live map of a service, from its start to its end: it shows the state, and begins and ends watches.

    The service goes on if it cannot be served; each watch tries again, for its network may come up later.
    """

    def __init__(self, settings: Config, address: PageAddress, stack: contextlib.AsyncExitStack) -> None:
        from sidelong.app.serve.resident import ServiceDisplay  # noqa: PLC0415  # as above
        from sidelong.app.view.display import ViewDisplay  # noqa: PLC0415  # as above

        self._stack = stack
        self._resident: Resident | None = None
        between = ServiceDisplay(say_plain, lambda: None, say_plain)
        self._view = ViewDisplay({"": between}, {"": settings}, address, is_service=True)

    async def open(self, resident: Resident | None = None) -> None:
        """Serve the page, unless it is served already; the service goes on where it cannot be."""
        from sidelong.app.view.display import served  # noqa: PLC0415  # as above

        if resident is not None:
            self._resident, self._view.service = resident, resident.request
        if self._view.is_served:
            return
        try:
            await self._stack.enter_async_context(served(self._view, say_plain))
        except InputError as error:
            self.log(f"the service goes on without the live map: {error}")
        self.draw()

    def log(self, text: str) -> None:
        """Print a text, also on the page."""
        say_plain(text)
        self._view.received(self._view, None, "note", text)

    def draw(self) -> None:
        """Show what the service does now; while a watch lasts the page follows that itself."""
        if self._resident is None or (status := self._resident.status).state in ("watching", "yielded"):
            return
        checks = [(check.name, check.ready, check.words) for check in self._resident.checks]
        last = self._resident.last
        summary = () if last is None else list(last.summary.rows())
        commands = () if last is None else (f"{program()} report {last.folder.path}",)
        text = "" if checks and status.state == "waiting" else status.reason
        self._view.show_stage(status.state, text, checks=checks, summary=summary, next=commands)

    @contextlib.asynccontextmanager
    async def decorate(self, display: ServiceDisplay) -> AsyncIterator[FlightDisplay]:
        """Show one watch on the page as well, until its end."""
        await self.open()
        self._view.adopt(display)
        self._view.show_stage("taking over", "the watch begins")
        try:
            yield self._view
        finally:
            self._view.let_go()


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


def confirm() -> None:
    """Confirm to sidelong serve that what the payload follows is the target, after a warning of another object.

    For example:
      sidelong confirm
    """
    _ask("confirm")


def _ask(request: str) -> None:
    answer = ask(request)
    text = f"{answer['text']}".rstrip(".")
    if not answer["accepted"]:
        raise FlightError(f"{request} refused: {text}.")
    say(plain(text))

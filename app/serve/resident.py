"""The service: waits for the vehicle, watches on request, and waits again; only its own end ends it.

| state | ends by |
| --- | --- |
| waiting | the checks before a launch pass: ready |
| ready | a request to watch: watching; the vehicle restarts or something is missing: waiting |
| watching | a pilot or another station flies: yielded; release, low battery, lost target: waiting |
| yielded | a request to watch: watching, after the checks; release: waiting |
| fault | the last watch failed; a request to watch tries again |
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
import os
import re
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.assembly import Prepared, prepared
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.loop import FlightDisplay, Wish
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.preflight import Check
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.session import Session, connected
from sidelong.app.flight.shell import FlightEnded, FlyingAircraft, Life, Shell
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import LinkError
from sidelong.app.records.run_folder import RunFolder, rotate
from sidelong.app.serve.control_socket import serving
from sidelong.app.serve.standby import MODES, Request, Standby, Triggers, VehicleGoneError
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Phase, Present
from sidelong.mission.core.events import Announce, OperatorRequest

_AGAIN_S = 2.0  # between two attempts to connect
_ROTATE_EVERY_S = 60.0
_POLL_S = 0.2
_RC_RATES, _RC_AFTER_S = (("RC_CHANNELS", 65, 2.0), ("SYS_STATUS", 1, 1.0)), 3.0
_WHO = {"socket": "a command", "vehicle": "the transmitter or a ground station"}

_SHARE = 3.0  # of the watchdog's period, between two signs of life
_MADV_DONTNEED, _M_ARENA_MAX = 4, -8
_LIBRARY = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-[x-]p .*/[^/]*\.so[.\d]*$")
_PRINTED = frozenset({"yield", "operator", "end", "takeover", "alarm", "clear", "health", "link", "position"})


@dataclass(eq=False)
class ServiceDisplay:
    """The ``FlightDisplay`` of one watch."""

    _log: Callable[[str], object]
    _changed: Callable[[], object]  # called when the flight is in another phase
    _refused: Callable[[str], object]  # receives why a resumption is refused
    request: Callable[[Wish], None] | None = None  # passes on an operator's wish, None before the flight takes any
    snapshot: Present | None = None

    @property
    def trouble(self) -> str:
        """The alarms of the flight in words, else why it is not known how well the target is watched."""
        present = self.snapshot
        alarms = () if present is None or present.vehicle is None else present.vehicle.alarms
        return "; ".join(alarm.text for alarm in alarms) or ("" if present is None else present.unknown)

    def note(self, text: str) -> None:
        self._log(text)

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        self.request = request

    def show_picture(self, picture: Callable[[], bytes]) -> None:
        """Show no picture: the page around it does."""

    def watching_began(self, start_s: float, duration_s: float | None) -> None:
        self._changed()

    def say(self, announcement: Announce) -> None:
        if announcement.kind == "refused":
            self._refused(announcement.text)
        elif announcement.kind in _PRINTED:
            self._log(announcement.text)

    def show(self, snapshot: Present) -> None:
        before, self.snapshot = self.snapshot, snapshot
        if before is None or (before.phase, before.over) != (snapshot.phase, snapshot.over):
            self._changed()


Decorate = Callable[[ServiceDisplay], contextlib.AbstractAsyncContextManager[FlightDisplay]]


class State(StrEnum):
    WAITING = "waiting"  # for a vehicle, its payload or what the checks miss
    READY = "ready"
    WATCHING = "watching"
    YIELDED = "yielded"
    FAULT = "fault"  # the last watch failed; a request to watch tries again


@dataclass(frozen=True, slots=True)
class Status:
    """What ``sidelong status`` shows."""

    state: State  # what the service does now
    reason: str = ""  # why, in words; '' where there is nothing to add
    vehicle: str = ""  # the vehicle that is connected, '' if none is
    run: str = ""  # the folder of the present watch, or of the last one; '' before the first
    watches: int = 0  # how many watches have begun since the service started
    disk_mb: float = 0.0  # what all run folders take, MB
    records: str = ""  # why records of the present or last watch are incomplete, '' if they are not

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else str(self.state)


class Resident:
    """One vehicle's service.

    Args:
        out: Where run folders are made.
        log: Receives lines, from any thread.
        decorate: Shows each watch elsewhere, too.
        changed: Called when another state, reason or list of checks is to be shown.
    """

    def __init__(
        self,
        config: Config,
        out: Path,
        log: Callable[[str], None],
        decorate: Decorate = contextlib.nullcontext,
        changed: Callable[[], object] = lambda: None,
    ) -> None:
        self.checks: tuple[Check, ...] = ()  # before the last watch
        self.last: FlightEnded | None = None
        self._config, self._out, self._log, self._decorate, self._changed = config, out, log, decorate, changed
        self._state, self._reason = State.WAITING, "not connected yet"
        self._vehicle = self._run = self._unwritten = ""
        self._recording: Recording | None = None  # of the present watch
        self._watches, self._disk_bytes = 0, 0
        self._wanted = False  # a watch was requested
        self._missing: str | None = self._reason  # what keeps a watch from beginning; None: it is being checked
        self._released = False  # the present watch
        self._display: ServiceDisplay | None = None
        self._life: Life | None = None
        self._session: Session | None = None
        self._triggers: Triggers | None = None

    @property
    def status(self) -> Status:
        """What `sidelong status` shows."""
        trouble = "" if self._display is None or self._state is not State.WATCHING else self._display.trouble
        reason, disk_mb = "; ".join(filter(None, (self._reason, trouble))), round(self._disk_bytes / 1e6, 1)
        return Status(self._state, reason, self._vehicle, self._run, self._watches, disk_mb, self._records)

    @property
    def _records(self) -> str:
        """Why the records of the present or last watch are incomplete, '' if they are not."""
        return self._unwritten if self._recording is None else self._recording.lost

    async def run(self, stopped: asyncio.Event, socket_path: Path) -> None:
        """Serve until ``stopped``.

        Raises InputError where the control socket cannot be made, or the configuration cannot be flown.
        """
        async with serving(socket_path, self._answer):
            notify("READY=1")
            living, ending = asyncio.create_task(self._live(stopped)), asyncio.create_task(stopped.wait())
            others = [ending, asyncio.create_task(feed_watchdog()), asyncio.create_task(self._keep_budget())]
            try:
                await asyncio.wait((living, ending), return_when=asyncio.FIRST_COMPLETED)
                if living.done():
                    living.result()
            finally:
                notify("STOPPING=1")
                if self._life is not None:
                    self._life.stopped.set()
                    await asyncio.wait((living,), timeout=30.0)  # the flight winds up
                for task in (living, *others):
                    task.cancel()
                await asyncio.gather(living, *others, return_exceptions=True)

    # -- requests ------------------------------------------------------------------------------------------

    def _answer(self, request: str) -> dict[str, Any]:
        accepted, text = (True, "") if request == "status" else self.request(request, _WHO["socket"])  # type: ignore[arg-type]
        return {"accepted": accepted, "text": text or str(self.status), "status": asdict(self.status)}

    def request(self, request: Request, who: str) -> tuple[bool, str]:
        """Process a request; return whether it is accepted, and its result in words."""
        takes = {"watch": self._watch, "release": self._release, "confirm": self._confirm}
        accepted, text = takes[request](who)
        self._log(f"{request} by {who}: {text}")
        if not accepted:
            self._inform_station(f"{request} refused: {text}")
        return accepted, text

    def _watch(self, who: str) -> tuple[bool, str]:
        display = self._display
        if display is None:
            if self._missing and self._state is not State.FAULT:
                return False, self._missing
            self._wanted = True
            return True, "the watch begins" if self._missing == "" else "the watch begins once the vehicle is checked"
        if self._is_ending:
            self._wanted = True
            return True, "another watch begins when this one has ended"
        snapshot = display.snapshot
        if snapshot is None or display.request is None or snapshot.phase not in (Phase.YIELDED, Phase.HOLDING):
            return False, "a watch is under way"
        display.request(OperatorRequest(snapshot.time_s, "resume", who=who))
        return True, "the vehicle is being checked; sidelong status shows whether the watch is resumed"

    @property
    def _is_beginning(self) -> bool:
        display = self._display
        return self._wanted or (display is not None and display.snapshot is None and not self._is_ending)

    @property
    def _is_ending(self) -> bool:
        snapshot = None if self._display is None else self._display.snapshot
        ended = snapshot is not None and snapshot.phase is Phase.ENDED
        return self._released or ended or (self._life is not None and self._life.stopped.is_set())

    def _release(self, who: str) -> tuple[bool, str]:
        display, life = self._display, self._life
        was_wanted, self._wanted = self._wanted, False
        if display is None or life is None or self._is_ending:
            return was_wanted, "the watch does not begin" if was_wanted else "no watch is under way"
        snapshot, self._released = display.snapshot, True
        if snapshot is not None and display.request is not None and snapshot.phase.in_control:
            display.request(OperatorRequest(snapshot.time_s, "end", who=who))
        else:
            life.stopped.set()
        self._become(self._state, "ending: released")
        return True, "the watch ends; the aircraft goes on with what it flies"

    def _confirm(self, who: str) -> tuple[bool, str]:
        display = self._display
        if display is None or display.snapshot is None or display.request is None or self._is_ending:
            return False, "no watch is under way"
        display.request(OperatorRequest(display.snapshot.time_s, "confirm", who=who))
        return True, "what is seen is taken as the target"

    def _on_message(self, message: Message) -> None:
        request = None if self._triggers is None else self._triggers.take(message)
        if request is None or (message.name in MODES and request == "release" and not self._is_beginning):
            return  # once sidelong has control, another mode is a takeover
        accepted, _ = self.request(request, _WHO["vehicle"])
        session = self._session
        if message.name in MODES or session is None:
            return
        own_id = session.vehicle.link.own_id
        to = message.fields.get("target_system"), message.fields.get("target_component")
        if to == own_id or (to == (own_id[0], 0) and not session.vehicle.is_companion):  # else the autopilot answers
            result = mavlink.MAV_RESULT_ACCEPTED if accepted else mavlink.MAV_RESULT_TEMPORARILY_REJECTED
            session.begin(session.vehicle.acknowledge(message, result))

    # -- life ----------------------------------------------------------------------------------------------

    async def _live(self, stopped: asyncio.Event) -> None:
        await self._prepare()
        while not stopped.is_set():
            obstacle = await self._attended(stopped)
            if obstacle:
                self._wanted, self._missing = False, obstacle
                self._become(State.WAITING, obstacle)
                await asyncio.sleep(_AGAIN_S)

    async def _prepare(self) -> None:
        loop = asyncio.get_running_loop()

        def announce(text: str) -> None:
            loop.call_soon_threadsafe(self._become, State.WAITING, text)

        await asyncio.to_thread(lambda: prepared(self._config, announce=announce))
        await asyncio.to_thread(release_unused)

    async def _attended(self, stopped: asyncio.Event) -> str:
        """Attend to one vehicle until it is gone; return why, '' if the service was stopped."""
        try:
            await self._attend(stopped)
        except InputError as error:  # no vehicle, or not one that can be used
            return str(error)
        except VehicleGoneError:
            return "the vehicle is silent, or has started again"
        except (LinkError, OSError) as error:
            return f"the link has failed: {error}"
        except Exception as error:  # a fault of the program: nothing is commanded, and the service goes on
            return f"a fault of the program: {error!r}"
        return ""

    async def _attend(self, stopped: asyncio.Event) -> None:
        """Stay connected, and watch as often as it is requested: a request is received at any time."""
        link = self._config.link
        self._vehicle, self.checks = "", ()
        if self._state is not State.FAULT:
            self._become(State.WAITING, f"waiting for the vehicle's heartbeat at {' and '.join(link.connections)}")
        link = link.model_copy(update={"role": link.role or "companion"})
        async with connected(link, self._log, self._frame) as session:
            self._join(session)
            try:
                standby = Standby(session, self._config)
                while not stopped.is_set():
                    await self._stand_by(session, standby)
                    await self._watch_once(session)
            finally:
                self._session = None

    def _frame(self, data: bytes) -> None:
        recording = self._recording
        if recording is not None:
            recording.frame(data)

    async def _stand_by(self, session: Session, standby: Standby) -> None:
        async with payload_input(self._config, session.vehicle, self._log):
            judging = asyncio.create_task(standby.run())
            try:
                while not (self._wanted and standby.missing == ""):
                    await asyncio.wait((judging,), timeout=_POLL_S)
                    if judging.done():
                        judging.result()
                    self._stands(standby.missing)
                    if self.checks != standby.found:
                        self.checks = standby.found
                        self._changed()
            finally:
                judging.cancel()
                await asyncio.gather(judging, return_exceptions=True)

    def _stands(self, missing: str | None) -> None:
        self._missing = missing
        if missing is None:
            if self._state is not State.FAULT:  # its reason is shown until something is missing or a watch begins
                self._become(State.WAITING, "the vehicle is being checked")
        elif missing:
            if self._wanted:
                self._wanted = False
                self._inform_station(f"watch refused: {missing}")
            self._become(State.WAITING, missing)
        elif self._state is not State.FAULT:
            self._become(State.READY, "")

    def _join(self, session: Session) -> None:
        """Listen to a session's vehicle, and to the stations on its link."""
        self._session = session
        vehicle, name = session.vehicle, session.autopilot.name
        self._vehicle = f"{name}, system {vehicle.system_id}"
        own = session.autopilot.mission_mode, session.autopilot.circle_mode
        # One for all sessions with a vehicle: a switch that is up stays up.
        if self._triggers is None or self._triggers.system_id != vehicle.system_id:
            self._triggers = Triggers(self._config.control, vehicle.system_id, own, vehicle.link.own_id)
        vehicle.bystanders.append(self._on_message)
        if self._config.control.rc_channel is not None:
            session.begin(self._keep_switch(session))

    async def _keep_switch(self, session: Session) -> None:
        """Request switch and health of the receiver as often as they fall silent: others switch them off."""
        vehicle = session.vehicle
        while True:
            await asyncio.sleep(_RC_AFTER_S)
            since_s = time.time() - _RC_AFTER_S
            silent = {
                number: rate_hz
                for name, number, rate_hz in _RC_RATES
                if name not in vehicle.latest or vehicle.latest[name].received_s < since_s
            }
            with contextlib.suppress(LinkError):
                await vehicle.set_rates(silent, rounds=2)

    async def _watch_once(self, session: Session) -> None:
        await asyncio.to_thread(self._rotate)
        if not self._wanted:  # released in the meantime
            return
        self._wanted = self._released = False
        self._missing = None
        self._watches += 1
        display = ServiceDisplay(self._log, self._follow, self._refused)
        self._display = display
        self._become(State.WATCHING, "the watch begins")
        try:
            ended = await self._flown(session, display)
            reason = ended.reason
            self._summarised(ended)
            self.last = ended
            text = ended.summary.outcome if reason is None else str(reason)
            failed = reason is not None and not isinstance(reason, InputError)
        except (FlightError, InputError, OSError) as error:
            failed, text = True, str(error)
        except Exception as error:  # a fault of the program, and the service goes on
            failed, text = True, f"a fault of the program: {error!r}"
        self._display = self._life = None
        self._log(f"the watch has ended: {text}; its records: {self._run}")
        self._become(State.FAULT if failed else State.WAITING, text)

    async def _flown(self, session: Session, display: ServiceDisplay) -> FlightEnded:
        folder = self._run_folder()
        self._run, self._unwritten = str(folder.path), ""
        recording = Recording(folder, self._config, self._log, required=False)
        life = self._life = Life(lambda: recording.begun, self._log)
        try:
            async with self._decorate(display) as shown:
                self._recording = recording
                own = self._config, folder, recording, shown, self._log, self._prepared
                return await Shell([FlyingAircraft(*own, session=session)], None, life, shown.note).fly()
        finally:
            self._recording = None  # from now on no frame is recorded
            recording.close()
            self._unwritten = recording.lost

    def _prepared(self) -> Prepared:
        done = prepared(self._config, announce=self._log)
        release_unused()
        return done

    def _run_folder(self) -> RunFolder:
        """Return a new run folder, elsewhere where the configured place takes none: a watch needs no disk."""
        for shared in (None, tempfile.gettempdir(), "/dev/shm"):
            try:
                # In a folder that all accounts share, only what is made there now is ours.
                parent = self._out if shared is None else Path(tempfile.mkdtemp(prefix="sidelong-runs-", dir=shared))
                return RunFolder.create(parent, datetime.now(UTC))
            except (InputError, OSError) as error:
                self._log(str(error))
        raise FlightError("there is no place for a run folder.")

    def _summarised(self, ended: FlightEnded) -> None:
        try:
            ended.folder.write_summary(ended.summary.as_json())
        except OSError as error:
            self._unwritten = self._unwritten or f"the summary cannot be written ({error.strerror})"
        if self._records:
            self._log(f"the records are incomplete: {self._records}")

    # -- what others receive ------------------------------------------------------------------------------

    def _refused(self, text: str) -> None:
        """Show a refused resumption to the person who asked for it."""
        self._become(self._state, text)
        self._inform_station(text)

    def _follow(self) -> None:
        snapshot = None if self._display is None else self._display.snapshot
        if snapshot is None or (self._released and snapshot.phase is not Phase.ENDED):
            return
        match snapshot.phase:
            case Phase.YIELDED:
                self._become(State.YIELDED, snapshot.over)
            case Phase.WAITING:
                self._become(State.WATCHING, "taking the aircraft over")
            case Phase.WATCHING | Phase.HOLDING:
                self._become(State.WATCHING, "" if snapshot.phase is Phase.WATCHING else "holding the circle")
            case Phase.ENDED:
                self._become(State.WATCHING, f"ending: {snapshot.over}")

    def _become(self, state: State, reason: str) -> None:
        if (state, reason) == (self._state, self._reason):
            return
        changed = state is not self._state
        self._state, self._reason = state, reason
        self._log(str(self.status))
        self._changed()
        notify(f"STATUS={self.status}")
        if changed:
            self._inform_station(str(self.status))

    def _inform_station(self, text: str) -> None:
        """Send a STATUSTEXT to the ground station, as far as there is a link."""
        session = self._session
        if session is not None:
            bad = self._state in (State.YIELDED, State.FAULT)
            severity = mavlink.MAV_SEVERITY_WARNING if bad else mavlink.MAV_SEVERITY_NOTICE
            session.begin(session.vehicle.send_text(f"sidelong {text}", severity))

    # -- the disk ------------------------------------------------------------------------------------------

    async def _keep_budget(self) -> None:
        while True:
            await asyncio.to_thread(self._rotate)
            await asyncio.sleep(_ROTATE_EVERY_S)

    def _rotate(self) -> None:
        control = self._config.control
        keep = timedelta(days=min(control.keep_days, 10_000.0))
        present = Path(self._run) if self._run else None
        budget_bytes, now = control.disk_budget_mb * 1e6, datetime.now(UTC)
        self._disk_bytes = rotate(self._out, budget_bytes, keep, now, self._log, present)


# -- the process -----------------------------------------------------------------------------------------------


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


def share_one_heap() -> None:
    """Let the threads that begin from now on allocate from one heap: each one of their own keeps unused memory."""
    with contextlib.suppress(OSError, AttributeError):  # another system, or another C library
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def release_unused() -> None:
    """Drop the pages of the libraries' code and constants (100 MB), and return freed memory to the system.

    Most were needed for the preparation only; pages that are called for again come from the file.
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # another system, or another C library
        library, region = ctypes.CDLL(None), None
        for line in Path("/proc/self/smaps").read_text().splitlines():
            region = _LIBRARY.match(line) or region
            if region and line.startswith("Anonymous:"):
                if line.split()[1] == "0":  # no page differs from the file's
                    begin, end = (int(address, 16) for address in region.groups())
                    library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)
                region = None
        library.malloc_trim(0)

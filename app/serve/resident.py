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
import tempfile
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.assembly import Prepared, prepared
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.display import FlightDisplay
from sidelong.app.flight.flight import Sharing
from sidelong.app.flight.life import Life
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.session import Session, connected
from sidelong.app.flight.single import FlightEnded, fly_single
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import LinkError
from sidelong.app.records.run_folder import RunFolder, rotate
from sidelong.app.serve.control_socket import serving
from sidelong.app.serve.display import ServiceDisplay
from sidelong.app.serve.memory import release_unused
from sidelong.app.serve.service_manager import feed_watchdog, notify
from sidelong.app.serve.standby import Standby, VehicleGoneError
from sidelong.app.serve.triggers import Request, Triggers
from sidelong.mission.control.snapshot import Phase
from sidelong.mission.core.events import OperatorRequest

_AGAIN_S = 2.0  # between two attempts to connect
_ROTATE_EVERY_S = 60.0
_RC_CHANNELS, _RC_HZ, _RC_AFTER_S = 65, 2.0, 3.0
_WHO = {"socket": "a command", "vehicle": "the transmitter or a ground station"}

Decorate = Callable[[ServiceDisplay], contextlib.AbstractAsyncContextManager[FlightDisplay]]


@contextlib.asynccontextmanager
async def undecorated(display: ServiceDisplay) -> AsyncIterator[FlightDisplay]:
    """Show a watch nowhere else."""
    yield display


class State(StrEnum):
    """What the service does now."""

    WAITING = "waiting"  # for a vehicle, its payload or what the checks miss
    READY = "ready"
    WATCHING = "watching"
    YIELDED = "yielded"
    FAULT = "fault"  # the last watch failed; a request to watch tries again


@dataclass(frozen=True, slots=True)
class Status:
    """What ``sidelong status`` shows.

    Attributes:
        state: What the service does now.
        reason: Why, in words; '' where there is nothing to add.
        vehicle: The vehicle that is connected, '' if none is.
        run: The folder of the present watch, or of the last one; '' before the first.
        watches: How many watches have begun since the service started.
        disk_mb: What all run folders take, MB.
        records: Why records of the present or last watch are incomplete, '' if they are not.
    """

    state: State
    reason: str = ""
    vehicle: str = ""
    run: str = ""
    watches: int = 0
    disk_mb: float = 0.0
    records: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else str(self.state)


class Resident:
    """One vehicle's service. log receives lines, from any thread; decorate shows each watch elsewhere, too."""

    def __init__(
        self,
        config: Config,
        out: Path,
        log: Callable[[str], None],
        sharing: Sharing = Sharing(),  # noqa: B008  # frozen
        decorate: Decorate = undecorated,
    ) -> None:
        self._config, self._out, self._log = config, out, log
        self._sharing, self._decorate = sharing, decorate
        self._state, self._reason = State.WAITING, "not connected yet"
        self._vehicle = self._run = self._unwritten = ""
        self._recording: Recording | None = None  # of the present watch
        self._watches, self._disk_bytes = 0, 0
        self._wanted = asyncio.Event()  # a watch was requested, and the vehicle is ready
        self._display: ServiceDisplay | None = None
        self._life: Life | None = None
        self._session: Session | None = None
        self._triggers: Triggers | None = None
        self._folder: Path | None = None

    @property
    def status(self) -> Status:
        """Where it stands."""
        trouble = "" if self._display is None or self._state is not State.WATCHING else self._display.trouble
        return Status(
            self._state,
            "; ".join(filter(None, (self._reason, trouble))),
            self._vehicle,
            self._run,
            self._watches,
            round(self._disk_bytes / 1e6, 1),
            self._records,
        )

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
        return {"accepted": accepted, "text": text or str(self.status), "status": self.status.as_json()}

    def request(self, request: Request, who: str) -> tuple[bool, str]:
        """Take a request; return whether it is accepted, and what comes of it in words."""
        accepted, text = self._watch(who) if request == "watch" else self._release(who)
        self._log(f"{request} by {who}: {text}")
        if not accepted:
            self._inform_station(f"{request} refused: {text}")
        return accepted, text

    def _watch(self, who: str) -> tuple[bool, str]:
        display = self._display
        if display is None:
            if self._state not in (State.READY, State.FAULT):
                return False, self._reason or f"the service is {self._state}"
            self._wanted.set()
            return True, "the watch begins"
        snapshot = display.snapshot
        if snapshot is None or display.request is None or snapshot.phase not in (Phase.YIELDED, Phase.HOLDING):
            return False, "a watch is under way"
        display.request(OperatorRequest(snapshot.time_s, "resume", who=who))
        return True, "the vehicle is being checked; sidelong status shows whether the watch is resumed"

    def _release(self, who: str) -> tuple[bool, str]:
        display, life = self._display, self._life
        if display is None or life is None:
            was_wanted = self._wanted.is_set()
            self._wanted.clear()
            return was_wanted, "the watch does not begin" if was_wanted else "no watch is under way"
        snapshot = display.snapshot
        if snapshot is not None and display.request is not None and snapshot.phase.in_control:
            display.request(OperatorRequest(snapshot.time_s, "end", who=who))
        else:
            life.stopped.set()
        return True, "the watch ends; the aircraft goes on with what it flies"

    def _on_message(self, message: Message) -> None:
        request = None if self._triggers is None else self._triggers.take(message)
        if request is not None:
            self.request(request, _WHO["vehicle"])

    # -- life ----------------------------------------------------------------------------------------------

    async def _live(self, stopped: asyncio.Event) -> None:
        await self._prepare()
        while not stopped.is_set():
            obstacle = await self._stood_by()
            if obstacle:
                self._become(State.WAITING, obstacle)
                await asyncio.sleep(_AGAIN_S)
                continue
            await self._watch_once()

    async def _prepare(self) -> None:
        """Compile and compute what a watch needs, before the first one."""
        loop = asyncio.get_running_loop()

        def announce(text: str) -> None:
            loop.call_soon_threadsafe(self._become, State.WAITING, text)

        await asyncio.to_thread(lambda: prepared(self._config, announce=announce))
        await asyncio.to_thread(release_unused)

    async def _stood_by(self) -> str:
        """Stand by until a watch is wanted of a vehicle that is ready; return what ended it before, '' if nothing."""
        try:
            await self._stand_by()
        except InputError as error:  # no vehicle, or not one that can be used
            return str(error)
        except VehicleGoneError:
            return "the vehicle is silent, or has started again"
        except (LinkError, OSError) as error:
            return f"the link has failed: {error}"
        except Exception as error:  # a fault of the program: nothing is commanded, and the service goes on
            return f"a fault of the program: {error!r}"
        return ""

    async def _stand_by(self) -> None:
        """Stay connected until a watch is wanted of a vehicle that is ready."""
        link = self._config.link
        async with (
            connected(
                link.connections,
                link.heartbeat_timeout_s,
                None,
                link.signing_key_file,
                self._log,
                link.system_id,
            ) as session,
            payload_input(self._config, session.vehicle, self._log),
        ):
            self._join(session)
            standby = Standby(session, self._config)
            judging = asyncio.create_task(standby.run())
            wanted = asyncio.create_task(self._wanted.wait())
            try:
                while not wanted.done():
                    await asyncio.wait((judging, wanted), timeout=0.5, return_when=asyncio.FIRST_COMPLETED)
                    if judging.done():
                        judging.result()
                    self._stands(standby.missing)
            finally:
                for task in (judging, wanted):
                    task.cancel()
                await asyncio.gather(judging, wanted, return_exceptions=True)
                self._session = None

    def _stands(self, missing: str | None) -> None:
        if missing is None:
            if self._state is not State.FAULT:  # its reason is shown until something is missing or a watch begins
                self._become(State.WAITING, "the vehicle is being checked")
        elif missing:
            self._wanted.clear()
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
            self._triggers = Triggers(self._config.control, vehicle.system_id, own)
        vehicle.bystanders.append(self._on_message)
        if self._config.control.rc_channel is not None:
            session.begin(self._ask_for_switch(session))

    async def _ask_for_switch(self, session: Session) -> None:
        await asyncio.sleep(_RC_AFTER_S)  # after the streams, which may switch it off
        with contextlib.suppress(LinkError):
            await session.vehicle.set_rates({_RC_CHANNELS: _RC_HZ})

    async def _watch_once(self) -> None:
        await asyncio.to_thread(self._rotate)
        if not self._wanted.is_set():  # released in the meantime
            return
        self._wanted.clear()
        self._watches += 1
        display = ServiceDisplay(self._log, self._follow, self._refused)
        self._display = display
        self._become(State.WATCHING, "the watch begins")
        try:
            ended = await self._flown(display)
            reason = ended.reason
            self._summarised(ended)
            text = ended.summary.outcome if reason is None else str(reason)
            failed = reason is not None and not isinstance(reason, InputError)
        except (FlightError, InputError, OSError) as error:
            failed, text = True, str(error)
        except Exception as error:  # a fault of the program, and the service goes on
            failed, text = True, f"a fault of the program: {error!r}"
        self._display = self._life = self._session = self._folder = None
        self._log(f"the watch has ended: {text}")
        self._become(State.FAULT if failed else State.WAITING, text)

    async def _flown(self, display: ServiceDisplay) -> FlightEnded:
        folder = self._run_folder()
        self._folder, self._run, self._unwritten = folder.path, str(folder.path), ""
        recording = self._recording = Recording(folder, self._config, self._log, required=False)
        life = self._life = Life(lambda: recording.begun, self._log)
        try:
            async with self._decorate(display) as shown:
                with contextlib.closing(recording):
                    return await fly_single(
                        self._config,
                        None,
                        folder,
                        recording,
                        shown,
                        self._sharing,
                        life,
                        self._log,
                        self._prepared,
                        self._join,
                    )
        finally:
            self._unwritten, self._recording = recording.lost, None

    def _prepared(self) -> Prepared:
        done = prepared(self._config, announce=self._log)
        release_unused()
        return done

    def _run_folder(self) -> RunFolder:
        """Return a new run folder, elsewhere where the configured place takes none: a watch needs no disk."""
        for parent in (self._out, Path(tempfile.gettempdir()) / "sidelong-runs", Path("/dev/shm/sidelong-runs")):
            try:
                return RunFolder.create(parent, datetime.now(UTC))
            except InputError as error:
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
        """Take the state from the flight."""
        snapshot = None if self._display is None else self._display.snapshot
        if snapshot is None:
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
        notify(f"STATUS={self.status}")
        if changed:
            self._inform_station(str(self.status))

    def _inform_station(self, text: str) -> None:
        """Send a STATUSTEXT to the ground station, as far as there is a link."""
        session = self._session
        if session is None:
            return
        severity = mavlink.MAV_SEVERITY_NOTICE
        if self._state in (State.YIELDED, State.FAULT):
            severity = mavlink.MAV_SEVERITY_WARNING
        session.begin(session.vehicle.send_text(f"sidelong {text}", severity))

    # -- the disk ------------------------------------------------------------------------------------------

    async def _keep_budget(self) -> None:
        while True:
            await asyncio.to_thread(self._rotate)
            await asyncio.sleep(_ROTATE_EVERY_S)

    def _rotate(self) -> None:
        control = self._config.control
        keep = timedelta(days=min(control.keep_days, 10_000.0))
        self._disk_bytes = rotate(self._out, control.disk_budget_mb * 1e6, keep, datetime.now(UTC), self._folder)

"""The link on MAVSDK 4. All workarounds for MAVSDK are in this module.

MAVSDK's blocking calls run in its own threads, cannot be cancelled, and hang ``destroy()`` while pending; using a
destroyed object crashes the process; an ``async for`` over a subscription never ends, and unsubscribes in
the loop's own thread when it is cancelled. Therefore:

- every blocking call goes through ``_bounded``: own timeout, remembered while it is pending;
- messages come by the subscription beneath the wrapper's;
- ``close`` sets a flag first, waits for what is pending, and destroys last, which unsubscribes, all of it in threads
  and within a bound; if something stays stuck, it leaves the instance alone, and ``sidelong.app.process`` ends the
  process in spite of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import json
import re
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from math import isfinite
from typing import Any, Literal

import mavsdk.logging
import msgspec
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.enums import ForwardingOption
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkDirectError, MavlinkMessage
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.errors import InputError
from sidelong.app.link.frames import Frame
from sidelong.app.link.message import Message, plain_fields
from sidelong.app.link.quality import LinkReport
from sidelong.app.link.raw_links import AUTOPILOT_COMPONENT, DO_AUX_FUNCTION, RawLinks
from sidelong.app.link.vehicle import LinkError

_LOOK_FOR_OTHERS_S = 2.0
# What other systems on the links are received for: their traffic, and an ally's mission.
_OF_OTHERS = (
    *("HEARTBEAT", "GLOBAL_POSITION_INT", "ADSB_VEHICLE", "OPEN_DRONE_ID_LOCATION"),
    *("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"),
)
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_PENDING_AT_CLOSE_S, _STEP_OF_CLOSE_S = 8.0, 5.0
_SEND_S, _PARAMETER_S = 2.0, 4.0
_WRONG_TYPE = {"WRONG_TYPE", "TYPE_MISMATCH"}  # by what MAVSDK knows, and by what PX4 answers

OWN_SYSTEM_ID = 245
"""MAVLink system id of this program as a ground station; as a companion it has the vehicle's own."""
STATION_ID = OWN_SYSTEM_ID, int(dialect.MAV_COMP_ID_MISSIONPLANNER)
_STATION = STATION_ID, int(dialect.MAV_TYPE_GCS)
_COMPANION_TYPE = int(dialect.MAV_TYPE_ONBOARD_CONTROLLER)
_COMPANION_IDS = range(dialect.MAV_COMP_ID_ONBOARD_COMPUTER, dialect.MAV_COMP_ID_ONBOARD_COMPUTER4 + 1)
_LOCAL = re.compile(r"serial.*|\w+://(127\.|localhost|0\.0\.0\.0).*")
Role = Literal["companion", "ground"]

SETTLING_S = 2.2  # two heartbeat periods: every vehicle present has sent one by then
_POLL_S, _EARLY_MAX, _LATE_S = 0.1, 10_000, 2.0


@mavsdk.logging.LogCallback  # type: ignore[untyped-decorator]  # MAVSDK has no types; the module keeps it alive
def _drop_log(_level: int, _message: bytes, _file: bytes, _line: int, _context: ctypes.c_void_p) -> bool:
    return True


class MavsdkLink:
    """``Link`` over MAVSDK; make one with :meth:`open`."""

    def __init__(
        self,
        instance: Mavsdk,
        system: Any,
        system_id: int,
        own_id: tuple[int, int],
        links: RawLinks,
        ours: contextlib.ExitStack,
    ) -> None:
        self.system_id, self.own_id = system_id, own_id
        self._links, self._ours = links, ours
        self._instance = instance
        self._direct = MavlinkDirectAsync(system)
        self._param = ParamAsync(system)
        self._closed = False
        self._pending: set[asyncio.Future[Any]] = set()
        self._queue: asyncio.Queue[MavlinkMessage | Frame | None] = asyncio.Queue()
        self._decoder = dialect.MAVLink(None)
        self._alongside: asyncio.Task[None] | None = None
        self._others: dict[int, MavlinkDirectAsync] = {}  # of other systems: kept, as they hold their subscriptions
        loop = asyncio.get_running_loop()

        def received(raw: MavlinkMessage | Frame, _nothing: object = None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended: there is no receiver
                loop.call_soon_threadsafe(self._queue.put_nowait, raw)

        self._received = links.on_request = received
        self._direct._plugin.subscribe_message("", received)

    @classmethod
    async def open(
        cls,
        links: contextlib.AbstractContextManager[RawLinks],
        timeout_s: float,
        system_id: int | None,
        role: Role | None,
        settling_s: float,
    ) -> MavsdkLink:
        """Connect and wait for the heartbeat of an autopilot: of ``system_id``, or of the only one on the link.

        Only heartbeats are sent before the vehicle is selected; messages received until then are kept.

        Without a role it is a companion where all links are serial or local and a ground station is received, else a
        ground station. PX4 takes the heartbeat of any ground station as its data link, so a companion sends none.

        Raises InputError as ``opened_links``, if no heartbeat arrives within ``timeout_s``, or if several vehicles
        are received within ``settling_s`` of the first frame and none is selected.
        """
        # The library's own subscription decodes texts of the vehicle as UTF-8; where that fails, MAVSDK prints the
        # bytes itself, escape sequences and all.
        mavsdk.logging._cmavsdk_lib.mavsdk_log_subscribe(_drop_log, None)
        instance, ours = None, contextlib.ExitStack()  # transports of our own
        try:
            raw = await asyncio.to_thread(ours.enter_context, links)  # a server may not answer for two seconds
            local = all(map(_LOCAL.fullmatch, raw.urls))
            is_station = role == "ground" or (role is None and not local)
            raw.speak_as(*(_STATION if is_station else ((OWN_SYSTEM_ID, _COMPANION_IDS[0]), _COMPANION_TYPE)))
            early: deque[bytes] = deque(maxlen=_EARLY_MAX)
            raw.start(early.append)
            where = " and ".join(map(repr, raw.urls))
            await _vehicle_received(raw, where, timeout_s, system_id)
            if system_id is None or (role is None and local):
                await asyncio.sleep(max(0.0, (raw.received_since_s or 0.0) + settling_s - time.monotonic()))
            vehicles = _vehicles(raw)
            if system_id is None and len(vehicles) > 1:
                found = _described(vehicles)
                raise InputError(
                    f"{where}: several vehicles share the link: {found}; select one with --set link.system_id=ID."
                )
            chosen = min(vehicles) if system_id is None else system_id
            if role is None:
                has_station = any(_kinds(frame)[0] == dialect.MAV_TYPE_GCS for frame in list(raw.heartbeats.values()))
                role = "companion" if local and has_station else "ground"
            own, mav_type = _STATION
            if role == "companion":
                free = (own_id for own_id in _COMPANION_IDS if (chosen, own_id) not in raw.heartbeats)
                own, mav_type = (chosen, next(free, _COMPANION_IDS[0])), _COMPANION_TYPE
            raw.speak_as(own, mav_type)
            instance = Mavsdk(Configuration.create_manual(*own, True))
            # The asyncio wrapper does not offer the subscription, the object beneath it does.
            instance._mavsdk.subscribe_raw_bytes_to_be_sent(raw.send)
            system = None
            # MAVSDK waits for its own callback, which may not come.
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s + _LATE_S):
                    await instance.add_any_connection("raw://", ForwardingOption.OFF)
                    instance._mavsdk.pass_received_raw_bytes(vehicles[chosen].data)
                    system = await instance.first_autopilot(timeout_s)
            if system is None:
                raise InputError(_not_received(where, timeout_s, raw.reports()))
            link = cls(instance, system, chosen, own, raw, ours)
            raw.deliver_to(instance._mavsdk.pass_received_raw_bytes, early)
        except BaseException:
            await _ended(instance, ours)
            raise
        raw.measures_delay = True
        link._alongside = asyncio.create_task(link._hear_others())
        return link

    def reports(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link since it was opened."""
        return self._links.reports()

    def recent(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link over the last seconds."""
        return self._links.recent()

    async def _hear_others(self) -> None:
        """Subscribe to other systems as they appear: a subscription of MAVSDK is for one system."""
        while not self._closed:
            systems = [(await system.get_system_id(), system) for system in await self._instance.get_systems()]
            for system_id, system in systems:
                if system_id != self.system_id and system_id not in self._others:
                    self._others[system_id] = direct = MavlinkDirectAsync(system)
                    for name in _OF_OTHERS:
                        direct._plugin.subscribe_message(name, self._received)
            await asyncio.sleep(_LOOK_FOR_OTHERS_S)

    # -- messages ------------------------------------------------------------------------------------------

    async def messages(self) -> AsyncIterator[Message]:
        while (raw := await self._queue.get()) is not None:
            message = _tapped(raw, self._decoder) if isinstance(raw, Frame) else _message(raw)
            if message is not None:
                yield message
            if not self._queue.empty():
                # A full queue never waits: messages that come faster than they are handled would shut out all else,
                # an interrupt too.
                await asyncio.sleep(0)

    async def send(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send a message; raises LinkError when MAVSDK does not take it."""
        # MAVSDK reads null as NaN; JSON itself has none.
        missing = dict.fromkeys(
            key for key, value in fields.items() if isinstance(value, float) and not isfinite(value)
        )
        message = MavlinkMessage(
            message_name=name,
            target_system_id=int(fields.get("target_system", 0)),
            target_component_id=int(fields.get("target_component", 0)),
            fields_json=json.dumps({**fields, **missing}),
        )
        try:
            await self._bounded(self._direct.send_message(message), _SEND_S)
        except (MavlinkDirectError, TimeoutError) as error:
            reason = str(error) or f"MAVSDK did not take it for {_SEND_S:g} s: is this computer too slow?"
            raise LinkError(f"{name} could not be sent: {reason}") from error

    @contextlib.contextmanager
    def serving(self, system_id: int, component_id: int) -> Iterator[Callable[[bytes], None]]:
        """Receive what is addressed to this component while inside; yield a function that sends frames of it."""
        served = system_id, component_id
        self._links.served.add(served)
        try:
            yield lambda frame: None if self._closed else self._links.send(frame)
        finally:
            self._links.served.discard(served)

    # -- parameters ----------------------------------------------------------------------------------------

    async def parameter(self, name: str) -> float | None:
        """Read a parameter of either type; None: the vehicle has none of that name."""
        param = self._param
        done, value = await self._typed(lambda: param.get_param_float(name), lambda: param.get_param_int(name))
        return float(value) if done else None

    async def set_parameter(self, name: str, value: float) -> bool:
        """Write a parameter of either type; return whether the vehicle accepted it."""
        write_float, write_int = self._param.set_param_float, self._param.set_param_int
        return (await self._typed(lambda: write_float(name, float(value)), lambda: write_int(name, round(value))))[0]

    async def _typed(self, *calls: Callable[[], Awaitable[Any]]) -> tuple[bool, Any]:
        """Return whether the call of the right type succeeded, and its result.

        MAVSDK requires the type: it reports a wrong type immediately, an unknown name after 3 s.
        """
        for call in calls:
            try:
                return True, await self._bounded(call(), _PARAMETER_S)
            except ParamError as error:
                if error.result.name not in _WRONG_TYPE:
                    break
            except TimeoutError:
                break
        return False, None

    # -- the traps -----------------------------------------------------------------------------------------

    async def _bounded(self, call: Awaitable[Any], timeout_s: float) -> Any:
        """Await a MAVSDK call that blocks a thread. Raises TimeoutError; the call then continues unobserved."""
        if self._closed:
            if asyncio.iscoroutine(call):
                call.close()  # else Python prints a warning that the coroutine was never awaited
            raise LinkError("the link is closed")
        pending = asyncio.ensure_future(call)
        self._pending.add(pending)
        pending.add_done_callback(self._settled)
        return await asyncio.wait_for(asyncio.shield(pending), timeout_s)

    def _settled(self, call: asyncio.Future[Any]) -> None:
        self._pending.discard(call)
        if not call.cancelled():
            call.exception()  # retrieved, so that asyncio does not log it as never retrieved

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._queue.put_nowait(None)
        if self._alongside is not None:
            self._alongside.cancel()
        if self._pending:
            await asyncio.wait(self._pending, timeout=_PENDING_AT_CLOSE_S)
        if not self._pending:
            await _ended(self._instance, self._ours)


def _message(raw: MavlinkMessage) -> Message | None:
    fields = plain_fields(msgspec.json.decode(raw.fields_json))
    if raw.message_name in _COMMANDS and fields["command"] == DO_AUX_FUNCTION:
        return None  # it was tapped before MAVSDK
    return Message(raw.message_name, raw.system_id, raw.component_id, fields, time.time())


def _tapped(frame: Frame, decoder: dialect.MAVLink) -> Message | None:
    try:
        decoded = decoder.decode(bytearray(frame.data))
    except dialect.MAVError:  # whole, and too short for what it claims to be
        return None
    fields = {name: getattr(decoded, name) for name in decoded.fieldnames}
    return Message(decoded.get_type(), frame.system_id, frame.component_id, fields, time.time())


def _not_received(what: str, timeout_s: float, reports: Sequence[LinkReport]) -> str:
    found = ", ".join(f"{count} {why}" for report in reports for why, count in report.refused.items())
    if found:
        return f"{what}: only frames that are refused: {found}; give the vehicle's key, or set it up: sidelong sign."
    return f"{what}: no autopilot was received within {timeout_s:g} s; check that it runs and sends MAVLink there."


async def _ended(instance: Mavsdk | None, ours: contextlib.ExitStack) -> None:
    """End the transports, which call the instance, and then that; what hangs is left alone."""
    for end in (ours.close, *(() if instance is None else (instance.destroy,))):
        ending = asyncio.ensure_future(asyncio.to_thread(end))
        _, hanging = await asyncio.wait((ending,), timeout=_STEP_OF_CLOSE_S)
        if hanging:
            return


async def _vehicle_received(raw: RawLinks, url: str, timeout_s: float, system_id: int | None) -> None:
    """Wait for the vehicle with ``system_id``, or the first one. Raises InputError if it is not received in time."""
    deadline_s = time.monotonic() + timeout_s
    while not (vehicles := _vehicles(raw)) or (system_id or min(vehicles)) not in vehicles:
        if time.monotonic() >= deadline_s:
            if not vehicles:
                raise InputError(_not_received(url, timeout_s, raw.reports()))
            found = _described(vehicles)
            raise InputError(f"{url}: system {system_id} sends nothing, only {found}; give another link.system_id.")
        await asyncio.sleep(_POLL_S)


def _vehicles(raw: RawLinks) -> dict[int, Frame]:
    """Return the latest heartbeat of each autopilot's system."""
    return {
        frame.system_id: frame
        for frame in list(raw.heartbeats.values())
        if frame.component_id == AUTOPILOT_COMPONENT and _kinds(frame)[1] != dialect.MAV_AUTOPILOT_INVALID
    }


def _kinds(heartbeat: Frame) -> tuple[int, int]:
    mav_type, mav_autopilot = heartbeat.payload.ljust(9, b"\0")[4:6]
    return mav_type, mav_autopilot


def _described(vehicles: Mapping[int, Frame]) -> str:
    described = []
    for system_id, frame in sorted(vehicles.items()):
        mav_type, mav_autopilot = _kinds(frame)
        names = (("MAV_AUTOPILOT", mav_autopilot), ("MAV_TYPE", mav_type))
        kinds = (dialect.enums[enum][value].name.removeprefix(f"{enum}_") for enum, value in names)
        described.append(f"system {system_id} ({', '.join(kind.replace('_', ' ').lower() for kind in kinds)})")
    return ", ".join(described)

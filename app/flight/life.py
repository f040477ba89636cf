"""The life of a flight: what ends it before its time, what the aircraft does then, and how that is told.

| | nothing commanded yet | on the way to the first circle, or watching | winding up |
| --- | --- | --- | --- |
| INT, TERM, HUP | given up at once | wound up, exit code 130 | told to wait, bounded |
| the simulated vehicle ends | failed, exit code 1 | wound up, exit code 1 | no matter |
| the first circle cannot be reached, a fault of ours | failed, exit code 1 | wound up, exit code 1 | exit code 1 |
| output cannot be written | refused where it is a record, exit code 2 | told, and flown on | told |

Wound up means: no plan is sent any more, borrowed parameters are set back, records are closed, the summary is
printed. The aircraft is left on its circle, which needs nobody. Records are deleted only when nothing was ever armed.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.link.message import Message
from sidelong.app.link.modes import ARMED_FLAG
from sidelong.app.link.queries import is_flying, mode_of
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle
from sidelong.app.shutdown import ends_within
from sidelong.mission.control.snapshot import Phase, Snapshot

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_WIND_UP_S = 60.0  # the bounds of what is done after an interrupt are together below this


class Life:
    """One flight's. ``begun`` tells whether the vehicle may have been commanded something.

    stopped is set when the flight is to be wound up. signal_name and failure say why; at most one is set.
    """

    def __init__(self, begun: Callable[[], bool], note: Callable[[str], object]) -> None:
        self.stopped = asyncio.Event()
        self.signal_name: str | None = None
        self.failure: str | None = None
        self.was_armed = False
        self._begun, self._note = begun, note
        self._task = asyncio.current_task()
        self._at_once = self._broken_off = False
        self._winding_up = contextlib.ExitStack()

    @contextlib.contextmanager
    def heeding_signals(self) -> Iterator[None]:
        """Take signals as the table says.

        asyncio's own way loses a signal when the loop is so far behind that the socket to wake it by is full.
        """
        loop = asyncio.get_running_loop()

        def heed(number: int, _frame: object) -> None:
            if self._at_once:
                self._broken_off = True
                raise KeyboardInterrupt
            loop.call_soon_threadsafe(self._signalled, number)

        heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        with self._winding_up:
            for number in heeded:
                signal.signal(number, heed)
            try:
                yield
            finally:
                for number in heeded:
                    signal.signal(number, signal.default_int_handler)

    @contextlib.contextmanager
    def computing(self) -> Iterator[None]:
        """Let a signal break off at once what is done meanwhile: the loop does not turn, and nothing has begun."""
        self._at_once = True
        try:
            yield
        except Exception as error:
            if self._broken_off:  # a library that was broken off half-way has an error of its own to tell
                raise KeyboardInterrupt from error
            raise
        finally:
            self._at_once = False

    def watch(self, vehicle: Vehicle) -> None:
        """Note from now on whether the vehicle is armed."""

        def hear(message: Message) -> None:
            if message.name == "HEARTBEAT" and message.component_id == AUTOPILOT_COMPONENT:
                self.was_armed |= self._begun() and bool(int(message.fields["base_mode"]) & ARMED_FLAG)

        vehicle.listeners.append(hear)

    def fail(self, reason: str) -> None:
        """End the flight for a reason that leaves no way on."""
        if not self._ending:
            self.failure = reason
            self._end()

    @property
    def _ending(self) -> bool:
        return self.signal_name is not None or self.failure is not None

    def _signalled(self, number: int) -> None:
        if self._ending:
            self._note(f"{signal.Signals(number).name}: winding up already; that takes {_WIND_UP_S:.0f} s at most")
            return
        self.signal_name = signal.Signals(number).name
        self._note(f"{self.signal_name}: winding up")
        self._end()

    def _end(self) -> None:
        self.stopped.set()
        self._winding_up.enter_context(ends_within(_WIND_UP_S, "winding up"))
        if not self._begun() and self._task is not None:
            self._task.cancel()  # there is nothing to wind up


def describe_aircraft(vehicle: Vehicle, autopilot: Autopilot, snapshot: Snapshot, simulated: bool) -> str:
    """Return what the aircraft does now that this program leaves off, as the end of a sentence."""
    if snapshot.phase is Phase.YIELDED:
        does = "somebody else flies the aircraft"
    elif not int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG:
        does = "the aircraft is not armed"
    elif mode_of(vehicle) not in (autopilot.mission_mode, autopilot.circle_mode):
        flies, mode = is_flying(vehicle), mode_of(vehicle)
        does = f"the aircraft flies on in {mode}" if flies else f"the aircraft is armed on the ground in {mode}"
    elif snapshot.phase is not Phase.WAITING:
        does = "the aircraft goes on circling where it is"
    else:
        does = "the aircraft flies to its first circle and stays on it"
    if simulated:
        return f"{does}, but it was simulated and ends with this program"
    return does if snapshot.sensor_status.connected else f"when last heard, {does}"

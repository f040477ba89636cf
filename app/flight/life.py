"""The life cycle of a flight: what ends it early, what the aircraft does then, and what is reported.

| | nothing commanded yet | flying to the first circle, or tracking | shutting down |
| --- | --- | --- | --- |
| INT, TERM, HUP | aborted at once | shut down, exit code 130 | asked to wait, with a time limit; then ignored |
| the simulated vehicle ends | failed, exit code 1 | shut down, exit code 1 | ignored |
| first circle unreachable, or internal error | failed, exit code 1 | shut down, exit code 1 | exit code 1 |
| output cannot be written | refused for a record, exit code 2 | reported; the flight continues | reported |

Shut down means: no further plan is sent, changed parameters are restored, records are closed and the summary is
printed. The aircraft stays on its circle, which needs no companion computer. Records are deleted only if the vehicle
was never armed.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.link.message import Message
from sidelong.app.link.queries import is_flying, mode_of
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle
from sidelong.app.process import ends_within
from sidelong.mission.control.present import Phase, Present

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_WIND_UP_S = 60.0  # the bounds of what is done after an interrupt are together below this


class Life:
    """Life cycle of one flight. ``begun``: returns whether a command may have been sent to the vehicle.

    stopped is set when the flight must shut down. signal_name or failure gives the reason; at most one is set.
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
        """Handle signals according to the table above.

        asyncio's own handler loses a signal when the loop is so late that its wake-up socket is full.
        """
        loop = asyncio.get_running_loop()

        def handle(number: int, _frame: object) -> None:
            if self._at_once:
                self._broken_off = True
                raise KeyboardInterrupt
            loop.call_soon_threadsafe(self._signalled, number)

        heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        with self._winding_up:
            for number in heeded:
                signal.signal(number, handle)
            try:
                yield
            finally:
                for number in heeded:
                    signal.signal(number, self._signalled_late)

    def _signalled_late(self, _number: int, _frame: object) -> None:
        """Let the records of a flight be completed, and its summary be written: that takes a moment."""
        if not self._begun():
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def computing(self) -> Iterator[None]:
        """Let a signal abort the work in this context at once: the event loop is blocked, nothing is commanded."""
        self._at_once = True
        try:
            yield
        except Exception as error:
            if self._broken_off:  # an interrupted library may raise its own error
                raise KeyboardInterrupt from error
            raise
        finally:
            self._at_once = False

    def watch(self, vehicle: Vehicle) -> None:
        """Note from now on whether the vehicle is armed."""

        def on_message(message: Message) -> None:
            if message.name == "HEARTBEAT" and message.component_id == AUTOPILOT_COMPONENT:
                self.was_armed |= self._begun() and bool(int(message.fields["base_mode"]) & ARMED_FLAG)

        vehicle.listeners.append(on_message)

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
            self._note(f"{signal.Signals(number).name}: shutting down already; that takes {_WIND_UP_S:.0f} s at most")
            return
        self.signal_name = signal.Signals(number).name
        self._note(f"{self.signal_name}: shutting down")
        self._end()

    def _end(self) -> None:
        self.stopped.set()
        self._winding_up.enter_context(ends_within(_WIND_UP_S, "shutting down"))
        if not self._begun() and self._task is not None:
            self._task.cancel()  # there is nothing to wind up


def describe_aircraft(vehicle: Vehicle, autopilot: Autopilot, snapshot: Present, simulated: bool) -> str:
    """Return what the aircraft does now that this program leaves off, as the end of a sentence."""
    if not int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG:
        does = "the aircraft is not armed"
    elif snapshot.phase is Phase.YIELDED:
        does = "a pilot or another station flies the aircraft"
    elif mode_of(vehicle) not in (autopilot.mission_mode, autopilot.circle_mode):
        flies, mode = is_flying(vehicle), mode_of(vehicle)
        does = f"the aircraft flies on in {mode}" if flies else f"the aircraft is armed on the ground in {mode}"
    elif snapshot.phase is not Phase.WAITING:
        does = "the aircraft goes on circling where it is"
    else:
        does = "the aircraft flies to its first circle and stays on it"
    if simulated:
        return f"{does}, but it was simulated and ends with this program"
    return does if snapshot.connected else f"by its last message, {does}"

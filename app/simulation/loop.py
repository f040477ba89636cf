"""The closed loop: what the vehicle sends becomes events, the core's outputs become frames, on one fake clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

from sidelong.app.flight.loop import VehicleReports
from sidelong.app.link.frames import OWN_ID, Packer
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.link.vehicle import VehicleMessages
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading, Reading
from sidelong.mission.core.events import ClockTick
from sidelong.mission.exchange.mission_controller import InboundEvent, MissionController, Output
from sidelong.mission.exchange.outbox import SendMessage
from sidelong.mission.exchange.reports import TakeoverRequested, TimerExpired

P = TypeVar("P")

_TIMERS_MAX = 4  # in one tick: a timer that is asked for at once comes again
_START_WITHIN_S = 60.0
_CLOCK_TICK_S = 1.0


class SimulatedVehicle(Protocol[P]):
    """A vehicle that sends packets of some kind and receives frames, on a clock that the loop moves."""

    @property
    def system_id(self) -> int: ...

    @property
    def tick_s(self) -> float: ...  # the time by which the loop moves its clock

    @property
    def time_s(self) -> float: ...  # its clock, which the loop moves; not the clock in its messages

    def advance(self, to_s: float) -> None: ...

    def receive(self, frame: bytes) -> None: ...

    def take(self) -> Sequence[P]:
        """Return the packets sent since the last call."""

    def messages(self, packets: Iterable[P], received_s: float) -> Iterable[Message | Reading]:
        """Return the messages in packets, one after the other."""


class ClosedLoop(Generic[P]):
    """One flight: :meth:`start`, then :meth:`step` or :meth:`run`; listeners get each event with its outputs."""

    def __init__(self, simulated: SimulatedVehicle[P]) -> None:
        self.simulated = simulated
        self.vehicle = VehicleMessages(simulated.system_id, OWN_ID)
        self.telemetry, self.reports = Telemetry(simulated.system_id), VehicleReports(self.vehicle)
        self.core: MissionController | None = None
        self.listeners: list[Callable[[InboundEvent, tuple[Output, ...]], object]] = []
        self._packer = Packer()
        self._sent: list[bytes] = []
        self._start_s = simulated.time_s
        self._tick_s = 0.0  # when the next tick of this computer's clock is due

    @property
    def link_s(self) -> float:
        """The link's clock, by which retries run."""
        return self.simulated.time_s - self._start_s

    def start(self, make_core: Callable[[LocalPlane], MissionController], flying_mode: str = "") -> None:
        """Wait until position and mode are known, and take over the aircraft, which flies in a mode or stands ('').

        Raises TimeoutError: the vehicle sends neither position nor heartbeat.
        """
        self.connect()
        assert self.telemetry.plane is not None
        self.core = make_core(self.telemetry.plane)
        self.take_over(flying_mode)

    def connect(self) -> None:
        """Wait until the vehicle's position and mode are known. Raises TimeoutError."""
        while self.telemetry.plane is None or "HEARTBEAT" not in self.vehicle.latest:
            if self.link_s > _START_WITHIN_S:
                raise TimeoutError("the simulated vehicle sends no position or no heartbeat")
            self.step()

    def take_over(self, flying_mode: str = "", round_trip_s: float = 0.0) -> None:
        """Ask the core to bring the aircraft onto a circle; flying_mode: '' on the ground."""
        flying = bool(flying_mode)
        request = TakeoverRequested(self.telemetry.now_s, self.link_s, flying, flying_mode, round_trip_s=round_trip_s)
        self.put(request)

    def run(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Fly on for ``duration_s`` or until a condition holds; return whether it held."""
        end_s = self.simulated.time_s + duration_s - 1e-6
        while self.simulated.time_s < end_s:
            self.step()
            if until():
                return True
        return False

    def step(self) -> None:
        """Move the clock by a step of the vehicle and process what it sends."""
        simulated = self.simulated
        if self._sent:
            sent, self._sent = self._sent, []
            for frame in sent:
                simulated.receive(frame)
        simulated.advance(simulated.time_s + simulated.tick_s)
        link_s = simulated.time_s - self._start_s
        for message in simulated.messages(self.arriving(), link_s):
            self.on_message(message)
        if self.core is not None and link_s >= self._tick_s:
            self._tick_s = link_s + _CLOCK_TICK_S
            self.put(ClockTick(self.telemetry.now_s, link_s))
        self.expire()

    def arriving(self) -> Iterable[P]:
        """Return the packets that the simulated vehicle has sent since this was last called."""
        return self.simulated.take()

    def on_message(self, message: Message | Reading) -> None:
        """Feed what the vehicle sent, and make the step that it leads to."""
        if type(message) is not Message:  # as most are
            if type(message) is PositionReading:
                self.telemetry.tick(message.time_s)
            if self.core is not None:
                self.put(message)
            return
        self.vehicle.take(message)
        event: InboundEvent | None = self.telemetry.event(message)
        if self.core is None:
            return
        if event is None:
            event = self.reports.report(message, self.telemetry.now_s, self.link_s)
        if event is not None:
            self.put(event)

    def expire(self) -> None:
        """Make the steps of timers that are due."""
        core, link_s = self.core, self.simulated.time_s - self._start_s
        for _ in range(_TIMERS_MAX):
            if core is None or core.next_timer_s > link_s:
                return
            self.put(TimerExpired(self.telemetry.now_s, link_s))

    def put(self, event: InboundEvent) -> tuple[Output, ...]:
        """Make one step, send its messages, call the listeners; return its outputs."""
        assert self.core is not None
        outputs = self.core.step(event)
        for output in outputs:
            if isinstance(output, SendMessage):
                self.send(output)
        for listener in self.listeners:
            listener(event, outputs)
        return outputs

    def send(self, message: SendMessage) -> None:
        self.transmit(self._packer.frame(message.name, message.fields, self.simulated.system_id))

    def transmit(self, frame: bytes) -> None:
        """Queue a frame for the vehicle; it takes it at its next tick."""
        self._sent.append(frame)

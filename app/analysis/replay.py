"""Replay of a recorded log through the same telemetry, filter and planner as a live flight.

The aircraft of a foreign log did not fly sidelong's plans. Each decision starts from the circle that it actually
flies (``ControlAcquired``), and a proposed plan fails: "not flown in this log".
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from sidelong.app.errors import InputError
from sidelong.app.records.journal import encode, to_builtins
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.sensing.readings import PositionReading, Reading
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Present
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    ControlAcquired,
    End,
    HealthChanged,
    NavigationReported,
    PlanStatus,
    StepOutput,
    UploadPlan,
    WindReported,
    Yield,
)
from sidelong.mission.exchange.mission_controller import DERIVED, UNSEEN, InboundEvent, MissionController, Output
from sidelong.mission.exchange.outbox import SendMessage, TakeoverFailed
from sidelong.mission.exchange.reports import ExchangeEvent, ShutdownRequested, TakeoverRequested

if TYPE_CHECKING:
    from sidelong.app.link.message import Message
    from sidelong.app.link.telemetry import Telemetry
    from sidelong.app.records.log import RecordedLog
    from sidelong.estimators.tracking.tracker import Tracker

_MODE = "as recorded"
# A set lookup by exact type is enough: only the exchange's own events have derived types.
_COMMANDS, _DERIVED = frozenset(get_args(StepOutput)), frozenset(DERIVED)
_EXCHANGE = frozenset((*get_args(ExchangeEvent), SendMessage, TakeoverFailed))
_READINGS = (*get_args(Reading), WindReported, NavigationReported)
_MIN_BANKED_CURVATURE = 0.25  # of the circle's own; a straighter flight is taken as the circle


_ROUNDING = 1e-6  # relative: costs of an x86-64 journal differ by 1e-8 on arm64
_SMALL = 1e-3  # numbers below it are compared by their difference: what is left of a subtraction has few digits


class Replayed(NamedTuple):
    """What one event of the log led to. estimate: the latest."""

    event: InboundEvent
    commands: tuple[StepOutput, ...]
    estimate: TargetEstimate | None
    snapshot: Callable[[], Present]  # the state after the event: to be asked for before the next one is taken


class Proposals:
    """Steps a watch through a flight that it does not fly: what it would do from where the aircraft is."""

    def __init__(self, controller: StandoffController) -> None:
        self.controller = controller
        controller.envelope.judges = False
        self._engaged_s = -math.inf

    def follow(self, events: Iterable[InboundEvent]) -> Iterator[Replayed]:
        """Yield the step's result for each reading that a consumer displays or scores; skip all others."""
        controller = self.controller
        for event in events:
            # A mode change in a recorded log is no reason to yield: there is no operator to yield to.
            if not isinstance(event, _READINGS):
                continue
            commands = controller.step(event)
            for command in commands:
                if isinstance(command, UploadPlan):
                    controller.step(PlanStatus(command.time_s, command.number, "failed", "not flown in this log"))
            if commands or type(event) not in UNSEEN:
                yield Replayed(event, commands, controller.estimate, controller.snapshot)
            if isinstance(event, PositionReading):
                self._engage()  # after it was seen: the circle is made up

    def _engage(self) -> None:
        controller = self.controller
        aircraft, time_s = controller.aircraft, controller.time_s
        if aircraft is None or controller.estimate is None or time_s - self._engaged_s < 1.0:
            return
        self._engaged_s = time_s
        airframe = controller.settings.aircraft
        curvature_per_m = aircraft.curvature_per_m
        if abs(curvature_per_m) < _MIN_BANKED_CURVATURE / airframe.radius_m:
            curvature_per_m = math.copysign(
                1.0 / airframe.radius_m, 1.0 if controller.settings.requirement.side.clockwise else -1.0
            )
        circle = Circle.tangent_to(
            aircraft.east_m, aircraft.north_m, aircraft.course_rad, 1.0 / abs(curvature_per_m), curvature_per_m > 0.0
        )
        controller.step(ControlAcquired(time_s, circle, _MODE))


def log_events(messages: Iterable[Message], telemetry: Telemetry) -> Iterator[InboundEvent]:
    """Yield the events of a log, from when the local plane is known: the first ones then."""
    early: list[InboundEvent] = []
    for message in messages:
        event = telemetry.event(message)
        if event is None:
            continue
        if telemetry.plane is None:
            early.append(event)
            continue
        if early:
            yield from early
            early.clear()
        yield event
    yield from early


def require_sightings(tracker: Tracker, telemetry: Telemetry, log: RecordedLog) -> None:
    """Raise InputError, with the reason, when a log held nothing to see a target by."""
    if tracker.sightings:
        return
    reasons = []
    for kind, selector in (("range", tracker.ranges), ("gimbal", tracker.gimbals)):
        never = {one: why for one in selector.seen if (why := selector.why_never(one, f"sensors.{kind}_component"))}
        if len(never) < len(selector.seen):
            continue  # one of them was used
        reasons += [f"the only {kind} {why.removeprefix('it ')}" for why in dict.fromkeys(never.values())]
        reasons += [
            f"{one.message} of component {one.component_id} was received {count} times, but {why}"
            for (of, one, why), count in telemetry.unusable.items()
            if of == kind
        ]
    raise InputError(f"{log.path}: no target can be seen in it: {'; '.join(reasons) or log.looked_for()}.")


def announcements(commands: Iterable[StepOutput]) -> Iterator[Announce]:
    """Yield what a display prints of the outputs: announcements except of plans, changes of health, and the end."""
    for command in commands:
        match command:
            case Announce() if command.kind != "plan":
                yield command
            case HealthChanged() | Yield() | End():
                yield command.announcement


@dataclass(frozen=True, slots=True)
class Difference:
    event: object
    flown: object
    replayed: object

    def __str__(self) -> str:
        return f"after {self.event}\n  flown:    {self.flown}\n  replayed: {self.replayed}"


class Comparison:
    """Compares what a replay puts out with what the flight did, in order.

    ``difference`` is the first other decision, or None; ``rounded`` counts commands that differ in last digits only,
    by ``greatest_rounding`` relative at most: another processor rounds otherwise. A flight that was cut off may lack
    the commands of its last event.
    """

    def __init__(self) -> None:
        self.compared = self.rounded = 0
        self.greatest_rounding = 0.0
        self.difference: Difference | None = None
        self._cause: object = None
        self._expected: deque[object] = deque()

    def replayed(self, event: object, outputs: Iterable[object]) -> None:
        """Note an event of the journal, and what the replay puts out for it."""
        if self._expected:
            self.flown(None)
        self._cause = event
        self._expected.extend(outputs)

    def flown(self, command: object) -> None:
        """Compare the next recorded output with the replayed one; None: nothing more was recorded for the event."""
        replayed = self._expected.popleft() if self._expected else None
        self.compared += 1
        same = command is not None and replayed is not None and self._is_same(command, replayed)
        if not same and self.difference is None and self._cause is not None:
            self.difference = Difference(self._cause, command, replayed)
        if command is None:
            self._expected.clear()

    def _is_same(self, flown: object, replayed: object) -> bool:
        if encode(flown) == encode(replayed):
            return True
        rounding = last_digits(flown, replayed)
        if rounding > _ROUNDING:
            return False
        self.rounded += 1
        self.greatest_rounding = max(self.greatest_rounding, rounding)
        return True

    def sameness(self) -> str:
        """Return in words how alike the outputs are of a replay without a difference."""
        if not self.rounded:
            return "all the same to the last bit"
        digits = f"{self.rounded} differ in their last digits, by {self.greatest_rounding:.0e} of the value at most"
        return f"all the same; {digits} (recorded on another kind of processor, or with other libraries)"


class JournalReplay(Comparison):
    """Steps a core through the journal of a sidelong run: the recorded events of the flight, in order.

    mission: the complete core, to compare uploads, switches and yields too. None: the controller alone is stepped,
    with the recorded results of the exchange: its state is the same. compares: whether to: a tenth of the time.
    Once another plan is sent than in the flight, the exchange is left out, and what is flown is judged by no plan.
    """

    def __init__(
        self, controller: StandoffController, mission: MissionController | None = None, *, compares: bool = True
    ) -> None:
        super().__init__()
        self._compares = compares
        self.controller = controller
        self._step: Callable[[Any], tuple[Output, ...]] = controller.step if mission is None else mission.step
        self._outputs: frozenset[type] = _COMMANDS if mission is None else frozenset(get_args(Output))
        self._left_out: frozenset[type] = _EXCHANGE if mission is None else frozenset()

    def run(self, records: Iterable[Any]) -> Iterator[Replayed]:
        """Yield the events of the journal with the step's present results; skip those that no consumer needs."""
        controller, outputs_too, left_out = self.controller, self._outputs, self._left_out
        sent: UploadPlan | None = None
        for record in records:
            kind = type(record)
            if kind is UploadPlan and controller.envelope.judges and not _is_same_plan(record, sent):
                controller.envelope.judges = False
                self._step, outputs_too, left_out = controller.step, _COMMANDS, _EXCHANGE
            if kind in left_out:
                if kind is ShutdownRequested:
                    return  # from here on the flight has stepped its exchange alone
                if kind is TakeoverRequested and not controller.resume_objection():
                    controller.resume()
                continue
            if kind in outputs_too:
                if self._compares:
                    self.flown(record)
                if kind in _DERIVED:
                    yield Replayed(record, (), controller.estimate, controller.snapshot)
                continue
            outputs = self._step(record)
            if self._compares:
                self.replayed(record, outputs)
            commands = tuple(output for output in outputs if isinstance(output, StepOutput)) if outputs else ()
            sent = next((one for one in commands if isinstance(one, UploadPlan)), sent)
            if commands or kind not in UNSEEN:
                yield Replayed(record, commands, controller.estimate, controller.snapshot)


def _is_same_plan(flown: UploadPlan, sent: UploadPlan | None) -> bool:
    if sent is None or sent.number != flown.number:
        return False
    return last_digits(sent.plan.circle, flown.plan.circle) < _ROUNDING


def last_digits(a: object, b: object) -> float:
    """Return the greatest relative difference between numbers of two commands; inf where anything else differs."""
    return math.inf if type(a) is not type(b) else _relative(to_builtins(a), to_builtins(b))


def _relative(a: Any, b: Any) -> float:
    if isinstance(a, float) and isinstance(b, float):
        if a == b or (math.isnan(a) and math.isnan(b)):
            return 0.0
        return abs(a - b) / max(abs(a), abs(b), _SMALL) if math.isfinite(a - b) else math.inf
    if isinstance(a, dict) and isinstance(b, dict) and list(a) == list(b):
        return max((_relative(a[key], b[key]) for key in a), default=0.0)
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return max(map(_relative, a, b), default=0.0)
    return 0.0 if type(a) is type(b) and a == b else math.inf

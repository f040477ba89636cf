"""The pure core as one step: the stand-off controller decides, the exchange with the autopilot carries it out.

One event in, everything that it leads to out, in order: what the exchange found out (``PlanStatus``,
``ControlAcquired``, ``ExternalControl``), the controller's commands, and the messages to the autopilot. No other road
leads in, so a replay of the journalled events repeats uploads, switches and yields to the last bit.

``next_timer_s`` asks for a ``TimerExpired``; nothing here sleeps.

Source: docs/decisions/0003-pure-exchange.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    TargetFixReading,
)
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import (
    ActivatePlan,
    Announce,
    ControlAcquired,
    End,
    Event,
    ModeReported,
    NavigationReported,
    PlanStatus,
    StepOutput,
    UploadPlan,
    Yield,
)
from sidelong.mission.exchange.dialect import AutopilotDialect, ExchangeSettings
from sidelong.mission.exchange.mission_items import MissionItemBackend
from sidelong.mission.exchange.orbit_command import OrbitCommandBackend
from sidelong.mission.exchange.outbox import ExternalControl, Outbox, SendMessage, TakeoverFailed
from sidelong.mission.exchange.reports import (
    CommandAcknowledged,
    ExchangeEvent,
    ExchangeInput,
    ShutdownRequested,
    TakeoverRequested,
    TimerExpired,
)
from sidelong.mission.exchange.takeover import Takeover
from sidelong.mission.exchange.vehicle_command import CommandExchange

DERIVED = (ControlAcquired, PlanStatus, ExternalControl)
_SENSED = frozenset((AttitudeReading, GimbalReading, RangeReading, TargetFixReading))

InboundEvent = Event | ExchangeEvent
PlanBackend = MissionItemBackend | OrbitCommandBackend
Output = StepOutput | SendMessage | TakeoverFailed | ControlAcquired | PlanStatus | ExternalControl

UNSEEN = frozenset((*_SENSED, NavigationReported, *get_args(ExchangeEvent)))
"""They only feed the filter and the plausibility check: nothing to display or score changes until a position."""


class MissionController:
    """One vehicle's whole core."""

    def __init__(self, controller: StandoffController, dialect: AutopilotDialect, settings: ExchangeSettings) -> None:
        self.controller = controller
        self._dialect = dialect
        self._outbox = Outbox()
        self._settings = settings
        self._restart()
        self._way_home: CommandExchange | None = None
        self._silent = self._closing = False
        self._mode = ""
        self._outputs: list[Output] = []

    def _restart(self) -> None:
        """Assume nothing of what is on board: at the start, and after another station has flown."""
        outbox, dialect, settings = self._outbox, self._dialect, self._settings
        self._missions = missions = MissionItemBackend(outbox, dialect, settings)
        orbits = OrbitCommandBackend(outbox, dialect, settings)
        self._backends: tuple[PlanBackend, ...] = (missions, orbits) if settings.by_command else (missions,)
        self._backend: PlanBackend = orbits if settings.by_command else missions
        self._takeover = Takeover(outbox, dialect, settings, missions, orbits)

    @property
    def next_timer_s(self) -> float:
        """When a ``TimerExpired`` is wanted at the latest, on the link's clock; -inf: at once, inf: never."""
        if self._way_home is not None:
            return self._way_home.next_timer_s
        if self._silent:
            return math.inf
        next_s = self._takeover.next_timer_s
        for backend in self._backends:  # asked for at every tick
            backend_s = backend.next_timer_s
            next_s = backend_s if backend_s < next_s else next_s
        return next_s

    @property
    def idle(self) -> bool:
        """Whether nothing is under way that should end before the program does."""
        if self._way_home is not None:
            return self._way_home.done
        return self._silent or self._backend.idle

    @property
    def loaded(self) -> bool:
        """Whether a mission of sidelong is on board."""
        return self._missions.layout is not None

    def snapshot(self) -> Present:
        """Return the state as a display wants it."""
        return replace(self.controller.snapshot(), waypoints_m=self._missions.waypoints_m)

    def step(self, event: InboundEvent) -> tuple[Output, ...]:
        """Process one event; return the resulting outputs, in order."""
        kind = type(event)
        if kind in _SENSED and not self._closing:
            outputs = self.controller.step(event)  # type: ignore[arg-type]
            if not outputs:
                return ()  # the exchange does not depend on it
        elif isinstance(event, ExchangeInput):
            self._outputs = []
            self._outbox.begin(event.time_s, event.link_s)
            self._exchange(event)
            self._settle()
            return tuple(self._outputs)
        else:
            outputs = () if self._closing else self.controller.step(event)
        self._outputs, outbox = [], self._outbox
        now_s = self.controller.time_s
        outbox.time_s = now_s if now_s > outbox.time_s else outbox.time_s
        if outputs:
            self._route(outputs)
        if kind is PositionReading or kind is ModeReported:
            self._observe(event)  # type: ignore[arg-type]
        if outbox.sent or outbox.derived:
            self._settle()
        return tuple(self._outputs)

    def _exchange(self, event: ExchangeEvent) -> None:
        if self._way_home is not None:
            if isinstance(event, CommandAcknowledged):
                self._way_home.receive(event)
            self._way_home.expire()
            return
        if self._silent:
            if isinstance(event, TakeoverRequested) and not self._closing:
                self._resume(event)
            return
        match event:
            case TimerExpired():
                for backend in self._backends:
                    backend.expire()
            case TakeoverRequested():
                self._takeover.begin(event)
            case ShutdownRequested():
                self._closing = True
                self._takeover.stop()
                self._backend.close()
            case _:
                for backend in self._backends:
                    backend.receive(event)
                self._takeover.receive(event)
        self._takeover.step()

    def _resume(self, request: TakeoverRequested) -> None:
        objection = self.controller.resume_objection()
        if objection:
            self._outbox.report(Announce(request.time_s, "refused", f"resume refused: {objection}"))
            return
        self.controller.resume()
        self._silent = False
        self._restart()
        self._takeover.begin(request)

    def _observe(self, event: Event) -> None:
        if type(event) is PositionReading:
            aircraft = self.controller.aircraft
            if aircraft is not None and not self._silent:
                self._backend.observe(aircraft, self._mode)
                self._takeover.observe(aircraft, event.height_m)
        elif type(event) is ModeReported:
            self._mode = event.mode
            if not self._silent:
                self._takeover.mode = event.mode

    def _settle(self) -> None:
        """Dispatch queued events until none remain."""
        outbox = self._outbox
        while outbox.sent or outbox.derived:
            self._outputs += outbox.sent
            outbox.sent.clear()
            derived, outbox.derived = outbox.derived, []
            for derivation in derived:
                event = derivation
                if isinstance(derivation, TakeoverFailed) and self.controller.resuming:
                    event = ExternalControl(derivation.time_s, f"not resumed, {derivation.reason}")
                self._outputs.append(event)
                if isinstance(event, DERIVED) and not self._closing:
                    self._route(self.controller.step(event))

    def _route(self, outputs: tuple[StepOutput, ...]) -> None:
        for output in outputs:
            self._outputs.append(output)
            if isinstance(output, Yield | End):
                self._silent = True
                self._takeover.stop()
                self._outbox.sent.clear()
                if isinstance(output, End) and output.action == "return":
                    self._way_home = CommandExchange(self._outbox, self._dialect.return_home())
            elif self._silent:
                continue
            elif isinstance(output, UploadPlan):
                self._backend.upload(output)
            elif isinstance(output, ActivatePlan):
                self._backend.activate(output)

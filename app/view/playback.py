"""A replay on a display, at so many times the recorded speed, with its buttons."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator

from app.analysis.replay import Replayed, announcements
from app.flight.display import FlightDisplay, Wish
from estimators.frames import LocalPlane
from mission.control.controller import StandoffController

_GAP_S = 5.0  # a longer silence in the recording is not waited for
_NAP_S = 0.05


class Playback:
    """plane: where the plane lies, None while it is not known yet. speed 0 is as fast as it goes."""

    def __init__(
        self,
        display: FlightDisplay,
        controller: StandoffController,
        plane: Callable[[], LocalPlane | None],
        speed: float,
        idle: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._display, self._controller, self._plane, self._speed = display, controller, plane, speed
        self._idle, self._clock, self._sleep = idle, clock, sleep

    def shown(self, steps: Iterable[Replayed]) -> Iterator[Replayed]:
        """Yield the steps as they are shown; ``idle`` is called while waiting for the next one's time."""
        begun = engaged = False
        shown_s, due_s = -math.inf, self._clock()
        for step in steps:
            snapshot, plane = step.snapshot, self._plane()
            if not begun and plane is not None:
                begun = True
                self._display.begin(plane, self._press)
            if not engaged and snapshot.estimate is not None:
                engaged = True
                self._display.engage(snapshot.time_s, None)
            if snapshot.time_s > shown_s:
                if self._speed > 0.0 and snapshot.time_s - shown_s < _GAP_S:
                    # One that is behind goes on from there: nothing is hurried through to catch up.
                    due_s = max(due_s + (snapshot.time_s - shown_s) / self._speed, self._clock())
                    self._wait_until(due_s)
                shown_s = snapshot.time_s
            for said in announcements(step.commands):
                self._display.say(said)
            self._display.show(snapshot)
            yield step

    def _wait_until(self, due_s: float) -> None:
        while (left_s := due_s - self._clock()) > 0.0:
            self._idle()
            self._sleep(min(left_s, _NAP_S))

    def _press(self, request: Wish) -> None:
        for said in announcements(self._controller.step(request)):
            self._display.say(said)

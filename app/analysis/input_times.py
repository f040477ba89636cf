"""How long each input was not ok."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass

from sidelong.mission.core.inputs import Input, InputReport, InputState


@dataclass(frozen=True, slots=True)
class InputTime:
    """How long an input was in a state, and how often it came into it."""

    input: Input
    state: InputState
    seconds: float
    times: int


class InputTimes:
    """Notes since when each input is in its state."""

    def __init__(self) -> None:
        self._latest: tuple[InputReport, ...] = ()
        self._changes: dict[Input, list[tuple[float, InputState]]] = defaultdict(list)

    def note(self, reports: tuple[InputReport, ...]) -> None:
        """Take the present states of all inputs, as a snapshot has them."""
        if reports is self._latest:  # displays ask at every event
            return
        self._latest = reports
        for one in reports:
            changes = self._changes[one.input]
            if not changes or changes[-1] != (one.since_s, one.state):
                changes.append((one.since_s, one.state))

    def between(self, start_s: float, end_s: float) -> tuple[InputTime, ...]:
        """Return the time that each input was in each state other than ok.

        Args:
            start_s: Earlier time does not count.
            end_s: Until when the present states have lasted.
        """
        seconds: dict[tuple[Input, InputState], list[float]] = defaultdict(list)
        for kind, changes in self._changes.items():
            for (since_s, state), (until_s, _) in itertools.pairwise([*changes, (end_s, InputState.OK)]):
                lasted_s = min(until_s, end_s) - max(since_s, start_s)
                if state is not InputState.OK and 0.0 < lasted_s < math.inf:
                    seconds[kind, state].append(lasted_s)
        return tuple(
            InputTime(kind, state, round(sum(lasted_s), 1), len(lasted_s))
            for (kind, state), lasted_s in seconds.items()
        )

"""Which of the devices on the link is the laser, and which the gimbal.

A vehicle speaks with many tongues: its own downward range sensor, the payload's range, and the same range once
more as the autopilot forwards it. Of each kind exactly one source is listened to at a time:

- a range that looks down (orientation 25), and the autopilot's RANGEFINDER, are never the laser of a gimbal;
- a payload component comes before the autopilot (component 1), which may only repeat it;
- a range of custom orientation (100), being on a gimbal, comes before one of a fixed orientation;
- a camera's tracker comes before the gimbal that it looks from;
- a gimbal comes before the quaternion that a range sensor may carry;
- if the source in use is silent for ``silent_after_s``, the next one that agrees with the track takes its place
  until the first returns; one that contradicts the track is refused until it has agreed for ``PROVEN_S`` on end.

An explicit choice replaces all of these but the last.

Source: fields of DISTANCE_SENSOR, <https://mavlink.io/en/messages/common.html#DISTANCE_SENSOR>.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from sidelong.estimators.sensing.readings import IMAGE_TRACKER, Source
from sidelong.estimators.settings import SourceChoice

_AUTOPILOT_COMPONENT = 1
LOOKS_DOWN = 25
_CUSTOM_ORIENTATION = 100
_REFUSED_MAX = 8
PROVEN_S = 8.0  # the aircraft turns by about half a lap in that time

Rank = Callable[[Source], int | None]


def range_rank(source: Source) -> int | None:
    """Return the rank of a source of ranges, lower is better; None for a source that cannot be the payload's."""
    from_autopilot = source.component_id == _AUTOPILOT_COMPONENT
    if source.orientation == LOOKS_DOWN or (from_autopilot and source.message == "RANGEFINDER"):
        return None
    fixed = source.message == "DISTANCE_SENSOR" and source.orientation != _CUSTOM_ORIENTATION
    return 2 * from_autopilot + fixed


def sight_rank(source: Source) -> int | None:
    """Return the rank of a source of lines of sight: a target in the image comes before the camera's axis."""
    if source.message == IMAGE_TRACKER:
        return -1
    return 2 * (source.message == "DISTANCE_SENSOR") + (source.component_id == _AUTOPILOT_COMPONENT)


def axis_rank(source: Source) -> int | None:
    """Return the rank of a source of the gimbal's own axis: an autopilot may repeat it late, with wrong flags."""
    return None if source.message == IMAGE_TRACKER else sight_rank(source)


@dataclass(slots=True)
class SourceSelector:
    """Picks one source of a kind as they come in."""

    rank: Rank
    choice: SourceChoice | None = None
    silent_after_s: float = 10.0
    chosen: Source | None = None
    refused: list[Source] = field(default_factory=list)
    received_s: float = -math.inf  # when the chosen one last spoke
    _ranks: dict[Source, int | None] = field(default_factory=dict)
    _agrees_since_s: dict[Source, float] = field(default_factory=dict)  # of refused sources

    @property
    def seen(self) -> tuple[Source, ...]:
        """Every source that was received."""
        return tuple(self._ranks)

    def may_use(self, source: Source) -> bool:
        """Return whether a source is in use, or could be: it is judged, and counts as received."""
        if self.chosen is not None:
            return source is self.chosen or source == self.chosen
        return self._rank_of(source) is not None

    def why_never(self, source: Source, key: str) -> str:
        """Return why a source is never used, and which value of a configuration key would use it; '' if it may be."""
        if self._rank_of(source) is not None:
            return ""
        if self.choice is not None:
            return f"it is not what {key} names"
        why = "it looks down" if source.orientation == LOOKS_DOWN else "it is a sensor of the autopilot"
        return f"{why}; {key} = {source.component_id} would use it"

    def accepts(self, source: Source, time_s: float, agrees: Callable[[], bool] = lambda: True) -> bool:
        """Return whether to use a reading; ``agrees`` with the track is asked before another source is replaced."""
        if source is not self.chosen and source != self.chosen:
            rank = self._rank_of(source)
            if rank is None:
                return False
            present = self._rank_of(self.chosen) if self.chosen else None
            better = present is None or rank < present
            if not better and time_s - self.received_s < self.silent_after_s:
                return False
            if self.chosen is not None and not self._may_replace(source, time_s, agrees=agrees()):
                return False
            self.chosen = source
            if source in self.refused:
                self.refused.remove(source)
        self.received_s = time_s if time_s > self.received_s else self.received_s
        return True

    def _may_replace(self, source: Source, time_s: float, *, agrees: bool) -> bool:
        if not agrees:
            self._agrees_since_s.pop(source, None)
            if source not in self.refused and len(self.refused) < _REFUSED_MAX:
                self.refused.append(source)
            return False
        return source not in self.refused or time_s - self._agrees_since_s.setdefault(source, time_s) >= PROVEN_S

    def _rank_of(self, source: Source) -> int | None:
        if source not in self._ranks:
            if self.choice is None:
                self._ranks[source] = self.rank(source)
            else:
                self._ranks[source] = 0 if self.choice.matches(source) else None
        return self._ranks[source]

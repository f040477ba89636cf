"""Where a new line goes in the vehicle's mission, so that an upload never disturbs the one being flown.

An upload may be cut anywhere, and ArduPlane stores items as they arrive. So the items of the present line keep
their places in every upload, and the new line goes where it cannot be reached from there: the present line ends in
a circle that never completes. Wherever the upload is cut, the vehicle flies on as before::

    [head] [present line ...circle] [new line ...circle]      after it, or
    [head] [new line ...circle] [present line ...circle]      before it, if it fits into the room there

What is left over between and behind them is never reached.

Source: docs/explanation/exchange.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sidelong.mission.upload.mission_item import MissionItem


@dataclass(frozen=True, slots=True)
class MissionLayout:
    """The vehicle's mission: ``items`` with the present line at [first, end). ``head`` items stay in front.

    min_items: it is kept that long, so that a new line finds places to be written to without a new list.
    """

    items: tuple[MissionItem, ...]
    head: int
    first: int
    end: int
    min_items: int = 0

    def __contains__(self, seq: int) -> bool:
        """Return whether an item belongs to the present path."""
        return self.first <= seq < self.end

    def line(self) -> tuple[MissionItem, ...]:
        """Return the items of the present line."""
        return self.items[self.first : self.end]

    def since(self, index: int) -> MissionLayout:
        """Return the same mission with the items before an index flown: their places are free for a new path.

        Args:
            index: Number of the first item still needed.
        """
        return replace(self, first=index) if index in self else self

    def with_line(self, line: Sequence[MissionItem]) -> MissionLayout:
        """Return the mission with the present path in place and another path as the next one.

        Returns:
            The layout; its first item is the start of the next path.
        """
        fits = len(line) <= self.first - self.head
        first = self.head if fits else self.end
        end = first + len(line)
        kept = max(self.end, self.min_items)
        return replace(self, items=(*self.items[:first], *line, *self.items[end:kept]), first=first, end=end)

    def filled(self) -> MissionLayout:
        """Return the mission with the circle that the present line ends in repeated until it has ``min_items``."""
        missing = self.min_items - len(self.items)
        return replace(self, items=(*self.items, *(self.items[self.end - 1 : self.end] * missing)))

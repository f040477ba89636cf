"""A replay on the page: played, paused, sought through; nothing of it commands anything."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sidelong.app.view.frames import Frames
from sidelong.app.view.state import Json

SPEED_MAX = 1000.0


class Player:
    """Playback state of a replay. what_if: the flight with other decisions, shown alongside; clock: wall time, s."""

    def __init__(
        self, frames: Frames, speed: float, clock: Callable[[], float], what_if: Frames | None = None
    ) -> None:
        self._frames, self._what_if, self._clock = frames, what_if, clock
        self._speed, self._playing = speed, True
        self._begin_s, self._end_s = frames.span_s
        self._at_s = frames.start_s if frames.start_s is not None else self._begin_s
        self._sent = -1  # index of the frame sent last; -1: start again
        self._sent_s = -math.inf
        self._looked_s = clock()

    def pressed(self, press: Json) -> None:
        """Take a button of the page."""
        self._advance()
        match press["action"]:
            case "play":
                self._playing = True
                if self._at_s >= self._end_s:
                    self._seek(self._begin_s)
            case "pause":
                self._playing = False
            case "speed":
                self._speed = min(max(press["value"], 0.1), SPEED_MAX)
            case "seek":
                self._seek(press["value"])
            case "step":
                self._playing = False
                there_s = self._frames.decided_next(self._at_s, press["value"] > 0.0)
                if there_s is not None:
                    self._seek(there_s)

    def update(self) -> Json:
        """Return the data to send to the page: all since the last call, or everything after a jump."""
        self._advance()
        frames, restarted = self._frames, self._sent < 0
        index, since_s = frames.index(self._at_s), -math.inf if restarted else self._sent_s
        update: dict[str, Any] = {
            "start_s": frames.start_s,
            "trail": frames.trail(max(self._sent + 1, 0), index + 1),
            "announcements": frames.announced_between(since_s, self._at_s),
            "state": frames.state(index),
            "replay": {"playing": self._playing, "speed": self._speed, "at_s": round(self._at_s, 2)},
        }
        if restarted:
            update |= {"restart": True, "states": frames.states_until(index)}
        if self._what_if is not None and self._what_if.times_s:
            other = self._what_if.state(self._what_if.index(self._at_s))
            update["state"]["what_if"] = {key: other[key] for key in ("proposed", "reason", "side")}
            announced = self._what_if.announced_between(since_s, self._at_s)
            update["announcements"] += [
                [time_s, "what-if", f"what if: {text}"] for time_s, kind, text in announced if kind == "decision"
            ]
            update["announcements"].sort(key=lambda one: one[0])
        self._sent, self._sent_s = index, self._at_s
        return update

    @property
    def setting(self) -> Json:
        """What the page needs to know of the whole."""
        decided_s = [round(time_s, 1) for time_s in self._frames.decided_s]
        return {"begin_s": round(self._begin_s, 1), "end_s": round(self._end_s, 1), "decided_s": decided_s}

    def _seek(self, time_s: float) -> None:
        self._at_s, self._sent = min(max(time_s, self._begin_s), self._end_s), -1

    def _advance(self) -> None:
        now_s = self._clock()
        if self._playing:
            self._at_s = min(self._at_s + (now_s - self._looked_s) * self._speed, self._end_s)
            self._playing = self._at_s < self._end_s
        self._looked_s = now_s

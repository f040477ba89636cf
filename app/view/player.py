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
        self._told = -1  # index of the frame sent last; -1: start again
        self._told_s = -math.inf
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

    def told(self) -> Json:
        """Return the data to send to the page: all since the last call, or everything after a jump."""
        self._advance()
        frames, anew = self._frames, self._told < 0
        index, since_s = frames.index(self._at_s), -math.inf if anew else self._told_s
        told: dict[str, Any] = {
            "start_s": frames.start_s,
            "trail": frames.trail(max(self._told + 1, 0), index + 1),
            "said": frames.said_between(since_s, self._at_s),
            "state": frames.state(index),
            "replay": {"playing": self._playing, "speed": self._speed, "at_s": round(self._at_s, 2)},
        }
        if anew:
            told |= {"restart": True, "states": frames.states_until(index)}
        if self._what_if is not None and self._what_if.times_s:
            other = self._what_if.state(self._what_if.index(self._at_s))
            told["state"]["what_if"] = {key: other[key] for key in ("proposed", "reason", "side")}
            said = self._what_if.said_between(since_s, self._at_s)
            told["said"] += [
                [time_s, "what-if", f"what if: {text}"] for time_s, kind, text in said if kind == "decision"
            ]
            told["said"].sort(key=lambda one: one[0])
        self._told, self._told_s = index, self._at_s
        return told

    @property
    def setting(self) -> Json:
        """What the page needs to know of the whole."""
        decided_s = [round(time_s, 1) for time_s in self._frames.decided_s]
        return {"begin_s": round(self._begin_s, 1), "end_s": round(self._end_s, 1), "decided_s": decided_s}

    def _seek(self, time_s: float) -> None:
        self._at_s, self._told = min(max(time_s, self._begin_s), self._end_s), -1

    def _advance(self) -> None:
        now_s = self._clock()
        if self._playing:
            self._at_s = min(self._at_s + (now_s - self._looked_s) * self._speed, self._end_s)
            self._playing = self._at_s < self._end_s
        self._looked_s = now_s

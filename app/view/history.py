"""What the page is shown, with versions: each page is sent what is newer than what it has, and never a queue.

This module is imported by the server's process and must stay quick to load: nothing of mission or estimators.
"""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import Any

Json = dict[str, Any]

_TRAIL_KEPT, _SERIES_KEPT, _WORDS_KEPT = 2400, 2400, 500  # 20 minutes of trail
_TRAIL_SENT, _SERIES_SENT = 600, 240  # at most of one aircraft in one answer: a slow line takes no more
_SERIES = ("nis", "range_age_s", "gimbal_age_s", "link_age_s")
_LISTS = ("trail", "announcements", "series")


class FrameHistory:
    """What the program has sent so far. clock_s: of this computer, s."""

    def __init__(self, aircraft: int = 1, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._aircraft, self._clock_s = aircraft, clock_s
        self._setting: Json = {}
        self._changed: dict[str, int] = {}  # the version in which the setting was sent last
        self._kept: Json = {}  # the latest state or states, stage, replay and start
        self._version, self._made_s = 0, clock_s()
        self._forget()

    def _forget(self) -> None:
        self._epoch = secrets.token_hex(4)
        kept = zip(_LISTS, (self._aircraft * _TRAIL_KEPT, _WORDS_KEPT, self._aircraft * _SERIES_KEPT), strict=True)
        self._lists: dict[str, deque[tuple[int, Any]]] = {name: deque(maxlen=most) for name, most in kept}

    def add(self, update: Json) -> None:
        """Take an update; a new stage, state or setting replaces the last, lists grow."""
        if update.get("restart"):
            self._forget()
            for key in ("state", "fleet"):
                self._kept.pop(key, None)
        # All processes of this computer share the clock: the time in a pipe counts as well.
        self._version, self._made_s = self._version + 1, update.get("made_s", self._clock_s())
        if "setting" in update:
            self._setting, self._changed["setting"] = update["setting"], self._version
        update.setdefault("series", samples(update))
        for name in _LISTS:
            self._lists[name].extend((self._version, one) for one in update.get(name, ()))
        if "stage" in update and update["stage"].get("name") != self._kept.get("stage", {}).get("name"):
            self._stage_since_s = self._made_s
        for key in ("start_s", "state", "fleet", "replay", "stage", "over"):
            if key in update:
                self._kept[key] = update[key]

    @property
    def cursor(self) -> str:
        """What a page that has everything up to now sends to get the rest."""
        return f"{self._epoch}.{self._version}"

    def since(self, have: str) -> Json:
        """Return what is newer than a page has, as one message; all of it, thinned, where it has nothing of this."""
        epoch, _, number = have.partition(".")
        restart = epoch != self._epoch or not number.isdigit()
        version = -1 if restart else int(number)
        lists = {name: [one for number, one in self._lists[name] if number > version] for name in _LISTS}
        lists["trail"] = _thinned(lists["trail"], self._aircraft * _TRAIL_SENT)
        lists["series"] = _thinned(lists["series"], self._aircraft * _SERIES_SENT)
        answer: Json = {"at": self.cursor, "age_s": round(self._clock_s() - self._made_s, 2), **self._kept, **lists}
        if "stage" in answer:
            answer["stage"] = answer["stage"] | {"for_s": round(self._clock_s() - self._stage_since_s, 1)}
        if restart:
            answer["restart"] = True
        if self._changed.get("setting", 0) > version:
            answer["setting"] = self._setting
        return answer


def _thinned(items: list[Any], most: int) -> list[Any]:
    """Return at most about this many, the latest whole: what is drawn far back needs less."""
    if len(items) <= most:
        return items
    recent = items[-most // 2 :]
    rest = items[: -most // 2]
    return rest[:: -(-len(rest) // (most // 2))] + recent


def samples(update: Json) -> list[Json]:
    return [sample(state) for state in ([update["state"]] if "state" in update else update.get("fleet", ()))]


def sample(state: Json) -> Json:
    """Return what the page's curves need of one aircraft's state."""
    target, aircraft = state["target"] or {}, state["aircraft"] or {}
    return {
        "name": state["name"],
        "time_s": state["time_s"],
        "target_m": target.get("at_m"),
        "range_m": target.get("range_m"),
        "angle_rad": target.get("angle_rad"),
        "bank_rad": aircraft.get("bank_rad"),
        **{key: state[key] for key in _SERIES},
    }

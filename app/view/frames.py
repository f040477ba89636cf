"""A replay as frames for the page (states every 0.2 s, messages, decision times), its playback, and its serving."""

from __future__ import annotations

import bisect
import contextlib
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from sidelong.app.analysis.replay import Replayed, announcements
from sidelong.app.config import Config
from sidelong.app.view.address import PageAddress
from sidelong.app.view.history import Json, sample
from sidelong.app.view.process import page_line, start_page, under_flight
from sidelong.app.view.shading import PictureFile, Shading
from sidelong.app.view.state import StateEncoder, setting
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import ControlAcquired, DecisionRecord
from sidelong.mission.route.route import Route

_STEP_S, _ROUNDING_S, _SAME_S = 0.2, 0.01, 3.0
_FRAMES_MAX = 50_000  # beyond, only every other one is kept
_TRAIL_MAX, _WORDS_MAX, _SAMPLES_MAX, _RECENT_S = 600, 400, 200, 180.0
SPEED_MAX = 1000.0


@dataclass(slots=True)
class Frames:
    """Frames of a replay: times_s, states (JSON); announced: (time_s, kind, text); decided_s: times of decided moves.

    start_s: when tracking began, else time of the first estimate. routes: the last one of each target, by its name.
    is_flown: the frames are of an aircraft of its own, not of decisions next to another one's path.
    """

    times_s: list[float] = field(default_factory=list)
    states: list[bytes] = field(default_factory=list)
    announced: list[tuple[float, str, str]] = field(default_factory=list)
    decided_s: list[float] = field(default_factory=list)
    start_s: float | None = None
    plane: LocalPlane | None = None
    routes: dict[str, Route] = field(default_factory=dict)
    is_flown: bool = False

    def noted(self, steps: Iterable[Replayed], encoder: StateEncoder, proposals: bool = False) -> Iterator[Replayed]:
        """Yield the steps, storing what the page needs. proposals: moves repeat each second; store each one once."""
        step_s, last_s, moved_s, watching = _STEP_S, -math.inf, -math.inf, False
        for step in steps:
            snapshot, encoder.plane = step.snapshot(), self.plane
            if isinstance(step.event, ControlAcquired) and not watching:
                self.start_s, watching = step.event.time_s, True
            if self.start_s is None and snapshot.estimate is not None:
                self.start_s = snapshot.time_s
            moves = [one.time_s for one in step.commands if isinstance(one, DecisionRecord) and one.moves]
            again = bool(proposals and moves and moves[0] < moved_s + _SAME_S)
            moved_s = moves[-1] if moves else moved_s
            self.decided_s += [] if again else moves
            announced = announcements(step.commands)
            self.announced += [
                (one.time_s, one.kind, one.text) for one in announced if not (again and one.kind == "decision")
            ]
            if snapshot.route is not None:
                self.routes[snapshot.target] = snapshot.route.route
            if snapshot.aircraft is not None and snapshot.time_s >= last_s + step_s - _ROUNDING_S:
                last_s = snapshot.time_s
                self.times_s.append(last_s)
                self.states.append(json.dumps(encoder.state(snapshot, 0.0), separators=(",", ":")).encode())
                if len(self.times_s) > _FRAMES_MAX:
                    step_s *= 2.0
                    del self.times_s[1::2], self.states[1::2]
            yield step

    def index(self, time_s: float) -> int:
        """Return the index of the last frame up to a time, or of the first frame if all are later."""
        return max(bisect.bisect_right(self.times_s, time_s) - 1, 0)

    def state(self, index: int) -> Json:
        """Return a recorded state as the page takes it."""
        state: Json = json.loads(self.states[index])
        return state

    def trail(self, begin: int, end: int) -> list[list[float]]:
        """Return where the aircraft was in frames [begin, end), as the page takes it, thinned."""
        every = max(1, (end - begin) // _TRAIL_MAX)
        places = ((self.times_s[k], self.state(k)["aircraft"]["at_m"]) for k in range(begin, end, every))
        return [[round(time_s, 1), *at_m] for time_s, at_m in places]

    def announced_between(self, after_s: float, until_s: float) -> list[list[object]]:
        """Return the latest announcements after one time up to another."""
        begin, end = (
            bisect.bisect_right(self.announced, time_s, key=lambda one: one[0]) for time_s in (after_s, until_s)
        )
        return [list(one) for one in self.announced[max(begin, end - _WORDS_MAX) : end]]

    def samples(self, begin: int, end: int) -> list[Json]:
        """Return what plots and paths need of frames [begin, end), thinned: after a jump all is sent at once."""
        recent = max(self.index(self.times_s[end - 1] - _RECENT_S), begin)
        parts = range(begin, recent), range(recent, end)
        chosen = [k for part in parts for k in part[:: -(-len(part) // _SAMPLES_MAX) or 1]]
        return [sample(self.state(k)) for k in dict.fromkeys((*chosen, end - 1))]

    def decided_next(self, time_s: float, ahead: bool) -> float | None:
        """Return the time of the next decision to move, or of the one before; None where there is none."""
        times_s = self.decided_s
        if ahead:
            return next((one for one in times_s if one > time_s + _STEP_S), None)
        return next((one for one in reversed(times_s) if one < time_s - _STEP_S), None)


class Player:
    """Playback state of a replay. what_if: the flight with other decisions, shown alongside; clock: wall time, s."""

    def __init__(
        self, frames: Frames, speed: float, clock: Callable[[], float], what_if: Frames | None = None
    ) -> None:
        self._frames, self._what_if, self._clock = frames, what_if, clock
        self._speed, self._playing = speed, True
        self._begin_s, self._end_s = frames.times_s[0], frames.times_s[-1]
        self._at_s = frames.start_s if frames.start_s is not None else self._begin_s
        self._sent = -1  # index of the frame sent last; -1: start again
        self._sent_s = -math.inf
        self._looked_s = clock()

    def pressed(self, press: Json) -> None:
        """Act on a button of the page: play, pause, speed, seek or step."""
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
        begin = max(self._sent + 1, 0)
        update: dict[str, Any] = {
            "start_s": frames.start_s,
            "trail": frames.trail(begin, index + 1),
            "series": frames.samples(begin, index + 1) if begin <= index else [],
            "announcements": frames.announced_between(since_s, self._at_s),
            "state": frames.state(index),
            "replay": {"playing": self._playing, "speed": self._speed, "at_s": round(self._at_s, 2)},
        }
        if restarted:
            update["restart"] = True
        if self._what_if is not None and self._what_if.times_s:
            update["state"]["what_if"] = self._other(self._what_if)
            announced = self._what_if.announced_between(since_s, self._at_s)
            update["announcements"] += [
                [time_s, "what-if", f"what if: {text}"] for time_s, kind, text in announced if kind == "decision"
            ]
            update["announcements"].sort(key=lambda one: one[0])
        self._sent, self._sent_s = index, self._at_s
        return update

    def _other(self, frames: Frames) -> Json | None:
        """Return what the page shows of the other flight now; None before it begins."""
        if frames.is_flown and self._at_s < frames.times_s[0]:
            return None
        other = frames.state(frames.index(self._at_s))
        keys = ("aircraft", "present", "coming") if frames.is_flown else ("proposed",)
        return {key: other[key] for key in ("reason", "side", *keys)}

    @property
    def at_s(self) -> float:
        """The time that is shown."""
        return self._at_s

    @property
    def setting(self) -> Json:
        """Return begin, end and decisions for the slider, s."""
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


_EVERY_S = 0.125


def serve_replay(
    frames: Frames,
    what_if: Frames | None,
    config: Config,
    address: PageAddress,
    name: str,
    speed: float,
    announce: Callable[[str], object],
    film: Callable[[float], bytes | None] | None = None,
) -> None:
    """Serve until Ctrl-C, or until the page's process ends; film returns the camera's picture of a time."""
    player = Player(frames, speed, time.monotonic, what_if)
    feed, url, _ = start_page(address, replay=True)
    has_ground = config.terrain.folder is not None
    shading = Shading(config, frames.plane) if has_ground and frames.plane is not None else None
    setting_sent = False
    pictures = None if film is None else PictureFile()
    announce(f"replay: {url} (Ctrl-C ends it)")
    try:
        with contextlib.suppress(KeyboardInterrupt):
            while feed.alive:
                for line in feed.lines():
                    player.pressed(json.loads(line))
                if feed.ready:
                    update = player.update() | {"made_s": time.monotonic()}
                    new_shade = shading is not None and shading.is_new()
                    if not setting_sent or new_shade:
                        base = setting(config, frames.plane, name, routes=frames.routes.values())
                        base |= {"replay": player.setting} | under_flight(address, shading, pictures)
                        update["setting"], setting_sent = base, True
                    if pictures is not None and film is not None:
                        update["picture"] = str(pictures.file)
                        picture = film(player.at_s)
                        if picture is not None:
                            pictures.put(lambda picture=picture: picture)  # type: ignore[misc]
                    if new_shade and shading is not None:
                        update["shade"] = str(shading.file)
                    feed.send(page_line(update))
                time.sleep(_EVERY_S)
    finally:
        feed.close()
        for one in (shading, pictures):
            if one is not None:
                one.close()

"""The health model: for every input its source, age and rate, and whether it agrees with the others.

Ages are counted on the vehicle's clock. Where that stands still, seconds of this computer (``ClockTick``) count.
While the link is down nothing else is judged: the loss of the link is reported separately.

Source: docs/health.md#inputs.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
)
from sidelong.estimators.sensing.sighting import Fix, SightingOutcome
from sidelong.estimators.tracking.payload_fit import OFTEN, PayloadFit
from sidelong.estimators.tracking.sources import SourceSelector
from sidelong.mission.core.events import ClockTick, Event, HealthChanged, LinkReported, ModeReported
from sidelong.mission.core.fleet import FleetAdvice
from sidelong.mission.core.inputs import ENVELOPE, Input, InputReport, InputState

_JUMPS_S = 60.0
_JUMPS = (
    f"the target's position jumped {OFTEN} times in {_JUMPS_S:.0f} s: check what the laser meets instead of it, "
    "and what the gimbal points at"
)
_REJECTED_SHARE, _ACCEPTED_AGAIN, _WINDOW_S, _SIGHTINGS_MIN = 0.25, 0.15, 30.0, 20
_SECONDS_MIN = 10  # with sightings: after a long gap the track is wrong at first, not the sightings
_FIXES_SHARE, _FIXES_MIN = 0.5, 10  # of fixes next to other sightings
_POOR_NIS = 5.991  # chi-square of two numbers, 95 %
_PITCH_LASTS_S = 20.0
_OFF_SIGHT = (
    "without a laser, they do not fit a target that moves on the ground: check the camera's field of view, its image "
    "axes and its delay, the gimbal's frame flags, and that the tracker follows the target"
)
_OFF_FIXES = (
    "the positions that beacon or camera report do not fit one another: check that one device alone reports, and "
    "that its error is as large as it states"
)
_OFF_BEACON = (
    "the position that beacon or camera report is not where the payload sees the target: check which target each of "
    "them follows, and how late the beacon is"
)

_OF_KINDS = 3
_RANGED, _ANGLES, _FIX = range(_OF_KINDS)


class SightingsCheck:
    """Whether the sightings agree with the track.

    If more than ``_REJECTED_SHARE`` of the sightings of 30 s are rejected, laser and line of sight do not agree.
    Lines of sight without a range, and fixes of a beacon or camera, count as rejected beyond what only 5 % of good
    ones exceed (``_POOR_NIS``): the filter adapts to wrong ones. So does the estimated pitch error: if it stays
    unexpected for ``_PITCH_LASTS_S``, the ground or the height of the aircraft is wrong. Next to other sightings,
    ``_FIXES_SHARE`` of the fixes is enough.

    Source: docs/health.md#contradictions-of-the-payload.
    """

    def __init__(self) -> None:
        self.fault = ""  # of laser and line of sight together, against the track, in words
        self._rejected: deque[list[int]] = deque()  # second, sightings of each kind, rejected of each kind
        self._pitch_off_s = math.inf  # since when the pitch error is unexpected

    def note(
        self,
        time_s: float,
        outcomes: Sequence[SightingOutcome],
        jumps_s: Sequence[float] = (),
        pitch_error_rad: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Process the outcomes of sightings, the last jumps of the target, and an unexpected pitch error."""
        second = math.floor(time_s)
        is_new = not self._rejected or self._rejected[-1][0] != second
        if is_new:
            self._rejected.append([second, *(2 * _OF_KINDS * [0])])
        counts = self._rejected[-1]
        for outcome in outcomes:
            sighting = outcome.sighting
            kind = _FIX if type(sighting) is Fix else _RANGED if sighting.has_range else _ANGLES
            counts[1 + kind] += 1
            counts[1 + _OF_KINDS + kind] += not outcome.accepted or (kind != _RANGED and outcome.nis > _POOR_NIS)
        if not is_new:
            return
        while self._rejected[0][0] < second - _WINDOW_S or self._rejected[0][0] > second:
            self._rejected.popleft()
        _, *numbers = map(sum, zip(*self._rejected, strict=True))
        given, rejected = numbers[:_OF_KINDS], numbers[_OF_KINDS:]
        total, fixes = sum(given), given[_FIX]
        share = sum(rejected) / total if total >= _SIGHTINGS_MIN else 0.0
        off_fixes = _FIXES_MIN <= fixes < total and rejected[_FIX] > _FIXES_SHARE * fixes
        covered = second - self._rejected[0][0] >= 0.8 * _WINDOW_S and len(self._rejected) >= _SECONDS_MIN
        jumps = len(jumps_s) == OFTEN and 0.0 <= time_s - jumps_s[0] < _JUMPS_S
        by_angles = 2 * given[_ANGLES] > total
        pitch_rad = pitch_error_rad() if by_angles else 0.0
        self._pitch_off_s = min(self._pitch_off_s, time_s) if pitch_rad else math.inf
        off_ground = time_s - self._pitch_off_s > _PITCH_LASTS_S
        if self.fault:
            if share < _ACCEPTED_AGAIN and not jumps and not off_ground and not off_fixes:
                self.fault = ""
        elif jumps:
            self.fault = _JUMPS
        elif covered and (off_fixes or (share > _REJECTED_SHARE and fixes)):
            self.fault = _OFF_FIXES if fixes == total else _OFF_BEACON
        elif covered and share > _REJECTED_SHARE:
            self.fault = (
                f"{100.0 * share:.0f} % of those of {_WINDOW_S:.0f} s were rejected: laser and line of sight "
                "do not agree; check the gimbal's frame flags and mounting and the laser's unit"
            )
            if by_angles:
                self.fault = _OFF_SIGHT
        elif off_ground:
            self.fault = (
                f"without a laser, they look {abs(math.degrees(pitch_rad)):.1f} degrees too "
                f"{'high' if pitch_rad > 0.0 else 'low'} for a target on the ground: check the heights of home, "
                "ground and aircraft, the gimbal's pitch and the camera's field of view"
            )


_AGE_MAX_S = {
    Input.POSITION: 3.0,
    Input.ATTITUDE: 3.0,
    Input.HEARTBEAT: 5.0,
    Input.LASER: 20.0,
    Input.GIMBAL: 5.0,
    Input.NEIGHBOURS: 5.0,
}
_TICKS_MARGIN = 1  # a tick may come right after a reading
_IN_USE_AFTER = 10  # readings; a device that gave fewer was not yet in use, and its replacement is no news
_EVALUATE_EVERY_S, _RATE_OVER_S = 1.0, 5.0
_KINDS: dict[type, Input] = {
    PositionReading: Input.POSITION,
    AttitudeReading: Input.ATTITUDE,
    ModeReported: Input.HEARTBEAT,
    RangeReading: Input.LASER,
    GimbalReading: Input.GIMBAL,
    FleetAdvice: Input.NEIGHBOURS,
}
_STALE = {
    Input.POSITION: "no position from the autopilot for {age:.0f} s: holding the circle and requesting it again",
    Input.ATTITUDE: "no attitude from the autopilot for {age:.0f} s: requesting it again",
    Input.HEARTBEAT: "no heartbeat from the autopilot for {age:.0f} s: nothing new is commanded",
    Input.LASER: "no range from the laser for {age:.0f} s: check that it is on and looks at the target",
    Input.GIMBAL: "no orientation from the gimbal for {age:.0f} s: check its power and its connection",
    Input.NEIGHBOURS: "no report of the fleet for {age:.0f} s: the other aircraft are assumed where they were",
}
_UNTRACKED = "no target in the camera's picture for {age:.0f} s: wait until it is found again, or click it there"
_LINK_LOST = "link lost: the aircraft goes on circling"
_JUDGED_WHILE_FRESH = (Input.POSITION, Input.LASER, Input.GIMBAL)
_WORDS = {
    Input.POSITION: "the aircraft's position",
    Input.ATTITUDE: "the aircraft's attitude",
    Input.HEARTBEAT: "the autopilot's heartbeat",
    Input.LASER: "the laser",
    Input.GIMBAL: "the gimbal",
    Input.SIGHTINGS: "the sightings",
    Input.LINK: "the link",
    Input.CLOCK: "the aircraft's clock",
    Input.TERRAIN: "the elevation data",
    Input.NEIGHBOURS: "the fleet's report",
    Input.HEIGHT: "the height",
    Input.FENCE: "the fences",
    Input.PATH: "the path flown",
    Input.AIRCRAFT: "the aircraft's limits",
    Input.SPEED: "the target's speed",
    Input.HOME: "home",
    Input.ORDERS: "the orders",
}


class _Received:
    """One input: when it was last received, how often, and its present state."""

    def __init__(self) -> None:
        self.last_s = self.rated_s = -math.inf
        self.count = self.of_source = self.rated_count = self.tick = self.since_tick = 0
        self.rate_hz = math.nan
        self.source: Source | None = None  # the device in use; another one does not make the input fresh
        self.state, self.since_s, self.text = InputState.MISSING, -math.inf, ""


class Health:
    """The states of all inputs. Every change is returned once by ``changes``."""

    def __init__(self, payload: PayloadFit) -> None:
        self.payload, self.sightings = payload, SightingsCheck()
        self._inputs = {kind: _Received() for kind in _WORDS}
        self._by_kind = {event: self._inputs[kind] for event, kind in _KINDS.items()}
        self.reports: tuple[InputReport, ...] = ()  # of every input that was ever received
        self.unknown = ""  # why it is not known how well the target is watched; '' while it is
        self._now_s = -math.inf
        self._evaluate_s = -math.inf
        self._ticks, self._moved_tick = 0, 0  # and when the vehicle's clock last went on
        self._connected = True
        self._is_news = True  # whether the reports have to be made again
        self._refused: set[Source] = set()

    def received(self, event: Event, now_s: float, lasers: SourceSelector | None = None) -> bool:
        """Note that an event came, whatever its content; return whether the states are due to be judged."""
        goes_on = self._ticks > self._moved_tick + _TICKS_MARGIN and now_s != self._now_s
        if goes_on:
            self._moved_tick, self._now_s = self._ticks, now_s
        kind, by_kind = type(event), self._by_kind
        if kind in by_kind and now_s > -math.inf:
            seen = by_kind[kind]
            if seen.source is None:
                is_input = not isinstance(event, RangeReading) or lasers is None or lasers.may_use(event.source)
            else:
                is_input = event.source is seen.source or event.source == seen.source  # type: ignore[union-attr]
            if is_input:
                seen.last_s, seen.tick = now_s, self._ticks
                seen.count += 1
        elif kind is ClockTick:
            self._ticks += 1
            if now_s == self._now_s:
                return True
            self._moved_tick, self._now_s = self._ticks, now_s
        return goes_on or now_s >= self._evaluate_s or self.payload.is_news or now_s < self._evaluate_s - 10.0

    def link_changed(self, event: LinkReported, now_s: float) -> HealthChanged:
        """Note that the link is lost or back; return its change of state."""
        self._connected = event.connected
        if event.connected:
            change = self._good_again(Input.LINK, now_s, "the link is back")
            for seen in self._inputs.values():  # ages begin again
                seen.last_s, seen.tick = now_s, self._ticks
        else:
            change = self._set(Input.LINK, InputState.STALE, now_s, _LINK_LOST)
        self.reports = self._made_reports()
        return change

    @property
    def silent_s(self) -> float:
        """For how many seconds of this computer the vehicle's clock has stood still."""
        ticks = self._ticks - self._moved_tick - _TICKS_MARGIN
        return float(ticks) if ticks > 0 else 0.0

    def is_usable(self, kind: Input) -> bool:
        """Return whether an input is neither stale nor inconsistent; one never seen is not judged."""
        return self._inputs[kind].state not in (InputState.STALE, InputState.INCONSISTENT)

    @property
    def payload_fault(self) -> str:
        """What is wrong with laser or gimbal so that their readings are not used, in words; empty: nothing."""
        for kind in (Input.LASER, Input.GIMBAL):
            if self._inputs[kind].state is InputState.INCONSISTENT:
                return self._inputs[kind].text
        return ""

    def _made_unknown(self) -> str:
        for kind in (Input.POSITION, Input.CLOCK, Input.LASER, Input.GIMBAL, Input.SIGHTINGS, Input.SPEED):
            state = self._inputs[kind].state
            if state is InputState.INCONSISTENT or (kind is Input.POSITION and state is InputState.STALE):
                return self._inputs[kind].text
        return ""

    def changes(
        self,
        now_s: float,
        lasers: SourceSelector,
        gimbals: SourceSelector,
        faults: Mapping[Input, str] = MappingProxyType({}),
    ) -> tuple[HealthChanged, ...]:
        """Judge all inputs, with reasons why the vehicle's own are not trusted; return what has changed."""
        self._evaluate_s = now_s + _EVALUATE_EVERY_S
        if not self._connected:
            return ()
        changed: list[HealthChanged] = []
        for kind in _KINDS.values():
            seen = self._inputs[kind]
            if seen.count:
                if not 0.0 <= now_s - seen.rated_s < _RATE_OVER_S:
                    self._rate(seen, now_s)
                is_fresh = now_s - seen.last_s <= _AGE_MAX_S[kind] and self._ticks == self._moved_tick
                if seen.state is not InputState.OK or not is_fresh:
                    self._judge_age(kind, now_s, changed)
        self.payload.is_news = False
        of_payload = {
            Input.LASER: self.payload.laser_fault,
            Input.GIMBAL: self.payload.gimbal_fault,
            Input.SIGHTINGS: self.sightings.fault,
            Input.TERRAIN: self.payload.terrain_fault,
        }
        for kind, fault in {**of_payload, **faults}.items():
            if fault or self._inputs[kind].state is InputState.INCONSISTENT:
                self._judge_fault(kind, fault, now_s, changed)
        devices = ((Input.LASER, lasers), (Input.GIMBAL, gimbals))
        for kind, selector in devices:
            self._judge_source(kind, selector.chosen, now_s, changed)
        for kind, selector in devices:
            for source in selector.refused:
                if source not in self._refused:
                    self._refused.add(source)
                    text = f"{_device(source)} contradicts the track: it is not used in place of {_WORDS[kind]}"
                    changed.append(HealthChanged(now_s, kind, self._inputs[kind].state, text))
        if self._is_news:  # displays ask at every event
            self.reports, self.unknown = self._made_reports(), self._made_unknown()
            self._is_news = False
        return tuple(changed)

    def _made_reports(self) -> tuple[InputReport, ...]:
        return tuple(
            InputReport(kind, seen.state, seen.since_s, seen.rate_hz, seen.text)
            for kind, seen in self._inputs.items()
            if seen.state is not InputState.MISSING
        )

    def _rate(self, seen: _Received, now_s: float) -> None:
        passed_s = now_s - seen.rated_s
        seen.rate_hz = (seen.count - seen.rated_count) / passed_s if 0.0 < passed_s < math.inf else math.nan
        seen.rated_s, seen.rated_count = now_s, seen.count
        self._is_news = True

    def _judge_age(self, kind: Input, now_s: float, changed: list[HealthChanged]) -> None:
        seen, limit_s = self._inputs[kind], _AGE_MAX_S[kind]
        ticks = self._ticks - seen.tick
        age_s = now_s - seen.last_s
        # On a vehicle's clock that runs faster than ours a tick is long, so that both have to be over the limit,
        # unless the vehicle's clock stands still.
        stands = self.silent_s >= limit_s
        if (age_s > limit_s and ticks > _TICKS_MARGIN) or (stands and ticks > limit_s + _TICKS_MARGIN):
            if seen.state is not InputState.STALE:
                is_camera = seen.source is not None and seen.source.message == IMAGE_TRACKER
                words = _UNTRACKED if is_camera else _STALE[kind]
                text = words.format(age=max(age_s, float(ticks) if stands else 0.0))
                changed.append(self._set(kind, InputState.STALE, now_s, text))
        elif seen.state is InputState.MISSING:
            self._set(kind, InputState.OK, now_s, "")  # the first reading is no news
        elif seen.state is InputState.STALE:
            changed.append(self._good_again(kind, now_s, f"{_WORDS[kind]} is received again"))

    def _judge_fault(self, kind: Input, fault: str, now_s: float, changed: list[HealthChanged]) -> None:
        state = self._inputs[kind].state
        if kind in _JUDGED_WHILE_FRESH and state in (InputState.STALE, InputState.MISSING):
            return
        text = f"{_WORDS[kind]}: {fault}"
        is_other = kind in ENVELOPE and text != self._inputs[kind].text
        if fault and (state is not InputState.INCONSISTENT or is_other):
            changed.append(self._set(kind, InputState.INCONSISTENT, now_s, text))
        elif not fault and state is InputState.INCONSISTENT and kind in ENVELOPE:
            changed.append(self._good_again(kind, now_s, f"{_WORDS[kind]}: within limits again"))
        elif not fault and state is InputState.INCONSISTENT:
            agree = "agree" if kind is Input.SIGHTINGS else "agrees"
            changed.append(self._good_again(kind, now_s, f"{_WORDS[kind]} {agree} again"))

    def _judge_source(self, kind: Input, source: Source | None, now_s: float, changed: list[HealthChanged]) -> None:
        seen = self._inputs[kind]
        before, seen.source = seen.source, source
        if before is source or before == source:
            return
        given, seen.of_source = seen.count - seen.of_source, seen.count
        self._is_news |= source is not None
        if before is None or source is None or given < _IN_USE_AFTER:
            return
        self._refused.discard(source)
        text = f"{_WORDS[kind]} in use is now {_device(source)}, before it was {_device(before)}"
        seen.last_s, seen.tick = now_s, self._ticks
        state = seen.state if seen.state is InputState.INCONSISTENT else InputState.SWITCHED
        changed.append(self._set(kind, state, now_s, text))

    def _set(self, kind: Input, state: InputState, now_s: float, text: str) -> HealthChanged:
        seen = self._inputs[kind]
        lasted_s = self._lasted_s(seen, now_s)
        seen.state, seen.since_s, seen.since_tick, seen.text = state, now_s, self._ticks, text
        self._is_news = True
        return HealthChanged(now_s, kind, state, text, lasted_s)

    def _good_again(self, kind: Input, now_s: float, text: str) -> HealthChanged:
        lasted_s = self._lasted_s(self._inputs[kind], now_s)
        return self._set(kind, InputState.OK, now_s, f"{text}, after {lasted_s:.0f} s")

    def _lasted_s(self, seen: _Received, now_s: float) -> float:
        """Return how long an input has been in its state; the vehicle's clock may have stood still since."""
        return max(now_s - seen.since_s, float(self._ticks - seen.since_tick)) if seen.since_s > -math.inf else 0.0


def _device(source: Source | None) -> str:
    return "" if source is None else f"component {source.component_id} ({source.message} {source.sensor_id})"

"""Clock tracking: the vehicle's clock from its time stamps, and its payload's clocks relative to it.

A stamp fits a clock when it is at most ``LATE_S`` behind its latest stamp and ``AHEAD_S`` ahead of it (on a slow link
three of its steps). The vehicle's clock follows one sequence of stamps. Deviating stamps begin another sequence. It
replaces the first one once it has lasted long enough without a stamp of the first: after a link outage or an
autopilot reboot. Two sequences that alternate repeatedly are two vehicles with one system id.

Source: docs/explanation/input-checks.md#plausibility.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass

LATE_S, AHEAD_S = 5.0, 2.0
SILENCE_MAX_S = 60.0  # a line this little ahead may well be the same clock after a silence
BOOTING_S = 60.0  # a sequence that begins nearer to zero than this means that the autopilot rebooted

PROOF_S = 20.0  # confirmation time of any other sequence

_QUICK_S, _REBOOT_S = 0.5, 2.0
_STAMPS_MIN = 5
_TURNS_MAX, _TURN_MAX_S, _SLOW_TURN_MAX_S = 8, 0.5, 3.0
_TICKS = 16
_SAMPLES, _SAMPLES_MIN, _SAMPLE_EVERY_S = 24, 12, 0.1
_CLUSTER_S, _CLUSTER_SHARE = 0.7, 0.75
_ROW_MIN, _ROW_S = 5, 2.0  # agreeing stamps in a row that replace the earlier ones
_DELAY_MAX_S, _EARLY_MAX_S = 1.0, 0.5


@dataclass(slots=True)
class _Line:
    first_s: float
    last_s: float
    count: int = 1
    turns: int = 0
    slow_turns: int = 0
    other_s: float = -math.inf  # the followed clock when this sequence was last received
    was_followed: bool = False


class VehicleClock:
    """The vehicle's clock: ``now_s`` is its latest accepted stamp, -inf before the first."""

    def __init__(self) -> None:
        self._own: _Line | None = None
        self._other: _Line | None = None
        self.now_s = -math.inf
        self.in_question = False  # another line speaks while the clock's own is silent
        self._misses = 0  # stamps in a row that fit neither line
        self._ticks_s: deque[float] = deque(maxlen=_TICKS)
        self.shift_s = 0.0  # how far the latest change of sequences moved the clock
        self.restarted = self.returned = False  # that change was by a reboot; to an earlier sequence
        self.two_lines_s: float | None = None  # distance of two alternating sequences
        self.slow_lines_s: float | None = None  # the same, if the second one is seldom received

    @property
    def tick_s(self) -> float:
        """Longest recent step of the clock: a payload's stamp may be this much ahead of it."""
        return max(self._ticks_s, default=1.0)

    @property
    def in_question_s(self) -> float | None:
        """Offset, s, of other stamps that arrive while the clock's own is silent; None: there is none."""
        if not self.in_question or self._own is None or self._other is None:
            return None
        return self._other.last_s - self._own.last_s

    @property
    def questioned_for_s(self) -> float:
        """How long that other sequence has lasted, s."""
        return self._other.last_s - self._other.first_s if self.in_question and self._other is not None else 0.0

    def goes_on(self, stamp_s: float) -> bool:
        """Accept a stamp, time since boot, if it continues the clock, as nearly all do; return whether it does."""
        own = self._own
        if own is None:
            self._own, self.now_s = _Line(stamp_s, stamp_s), stamp_s
            return True
        ordinary_s = own.last_s + AHEAD_S
        if own.last_s - LATE_S <= stamp_s and (stamp_s <= ordinary_s or stamp_s <= own.last_s + self._ahead_max_s):
            if stamp_s > own.last_s:
                self._ticks_s.append(stamp_s - own.last_s)
                own.last_s = self.now_s = stamp_s
            own.count += 1
            self.in_question = False
            return True
        return False

    @property
    def _ahead_max_s(self) -> float:
        """How far a step may go; only one beyond the ordinary asks how long they are here."""
        if not self._ticks_s:
            return AHEAD_S
        return min(max(AHEAD_S, 3.0 * statistics.median(self._ticks_s)), LATE_S)

    def take(self, stamp_s: float, confirmed_after_s: float | None = None) -> bool:
        """Process a stamp, time since boot; return whether another sequence, now confirmed, takes over."""
        own, other = self._own, self._other
        if self.goes_on(stamp_s) or own is None:
            return False
        gone_s = max(0.0, own.last_s - other.other_s) if other is not None else 0.0
        if other is None or not other.last_s - LATE_S <= stamp_s <= other.last_s + gone_s + AHEAD_S:
            self._misses += 1
            if self.in_question and other is not None and other.count >= _STAMPS_MIN > self._misses:
                return False  # it fits neither line
            other = self._other = _Line(stamp_s, stamp_s, other_s=own.last_s)
            self._misses = 0
        else:
            self._misses = 0
            if not self.in_question:  # a stamp of the followed sequence has arrived since
                other.turns = other.turns + 1 if gone_s < _TURN_MAX_S else 0
                other.slow_turns = other.slow_turns + 1 if gone_s < _SLOW_TURN_MAX_S else 0
                other.first_s, other.count = stamp_s, 0
            other.last_s = max(other.last_s, stamp_s)
            other.count += 1
            other.other_s = own.last_s
        self.in_question = True
        if other.slow_turns >= _TURNS_MAX:
            self.slow_lines_s = abs(other.last_s - own.last_s)
        if other.turns >= _TURNS_MAX:
            self.two_lines_s = abs(other.last_s - own.last_s)
        begun = own.count >= _STAMPS_MIN  # before, there is nothing to hold on to
        if confirmed_after_s is None:
            confirmed_after_s = self._confirmed_after_s(own, other)
        lasts = other.last_s - other.first_s >= confirmed_after_s and other.count >= _STAMPS_MIN
        if not lasts and (begun or other.count <= own.count):
            return False
        self.shift_s = other.last_s - own.last_s
        self.restarted = begun and self.shift_s < 0.0 and not other.was_followed
        self.returned = other.was_followed
        own.was_followed, own.other_s, own.turns = True, other.last_s, 0
        self._own, self._other, self.now_s = other, own, other.last_s
        self.in_question = False
        self._ticks_s.clear()
        return True

    @staticmethod
    def _confirmed_after_s(own: _Line, other: _Line) -> float:
        ahead_s = other.last_s - own.last_s
        if other.was_followed or 0.0 < ahead_s <= SILENCE_MAX_S:
            return _QUICK_S
        return _REBOOT_S if ahead_s < 0.0 and other.first_s < BOOTING_S else PROOF_S


class SourceClock:
    """One payload source's clock against the vehicle's."""

    def __init__(self) -> None:
        self.ahead_s = 0.0  # of the vehicle's clock; 0 while the stamps agree with it up to what a link may delay
        self._samples: deque[float] = deque(maxlen=_SAMPLES)
        self._sampled_s = -math.inf
        self._usual = 0  # samples in a row that agree with the vehicle's clock
        self._row, self._row_s, self._row_since_s = 0, math.nan, -math.inf

    def corrected_s(self, stamp_s: float, clock: VehicleClock) -> float | None:
        """Return a stamp on the vehicle's clock; None if it fits neither that clock nor the source's own."""
        ahead_s = stamp_s - clock.now_s
        # A clock that stands still gives no measurement.
        if not -_SAMPLE_EVERY_S < clock.now_s - self._sampled_s < _SAMPLE_EVERY_S:
            self._sampled_s = clock.now_s
            self._samples.append(ahead_s)
            self._usual = self._usual + 1 if -_DELAY_MAX_S <= ahead_s <= _EARLY_MAX_S else 0
            lasts = self._lasts(ahead_s)
            if self.ahead_s or self._usual < _SAMPLES:  # else all samples agree with the vehicle's clock
                self._estimate(clock.tick_s, lasts)
        if not self.ahead_s and -LATE_S <= ahead_s <= AHEAD_S:  # as nearly all are
            return stamp_s
        early_s = AHEAD_S + clock.tick_s  # the vehicle's own last words may be lost
        late_s = LATE_S
        if self.ahead_s:  # where it is off by more, the vehicle's own clock may have been set
            early_s, late_s = _DELAY_MAX_S + clock.tick_s, _DELAY_MAX_S
        if -late_s <= ahead_s - self.ahead_s <= early_s:
            return stamp_s - self.ahead_s
        return stamp_s if -_DELAY_MAX_S <= ahead_s <= early_s else None

    def _lasts(self, ahead_s: float) -> bool:
        """Return whether the latest stamps agree for long enough to know the clock without those before."""
        if not -_CLUSTER_S <= ahead_s - self._row_s <= _CLUSTER_S:
            self._row, self._row_s, self._row_since_s = 0, ahead_s, self._sampled_s
        self._row += 1
        lasts = self._row >= _ROW_MIN and self._sampled_s - self._row_since_s >= _ROW_S
        if lasts and self._row < _SAMPLES:
            while len(self._samples) > self._row:
                self._samples.popleft()
        return lasts

    def _estimate(self, tick_s: float, lasts: bool) -> None:
        if len(self._samples) < _SAMPLES_MIN and not lasts:
            return
        ordered = sorted(self._samples)
        middle_s = ordered[len(ordered) // 2]
        near = ordered
        if ordered[-1] - middle_s > _CLUSTER_S or middle_s - ordered[0] > _CLUSTER_S:
            near = [ahead_s for ahead_s in ordered if abs(ahead_s - middle_s) <= _CLUSTER_S]
        if len(near) < _CLUSTER_SHARE * len(ordered):
            return
        least_delayed_s = near[3 * len(near) // 4]
        if -_DELAY_MAX_S <= least_delayed_s <= _EARLY_MAX_S + tick_s:
            self.ahead_s = 0.0
        elif abs(least_delayed_s - self.ahead_s) > _CLUSTER_S:
            # Not at every sample: a correction that moves with each would add its noise to the sightings.
            self.ahead_s = least_delayed_s

"""Flights with faults drawn at random, each next to the same flight without, judged by what must hold in all."""

from __future__ import annotations

import gc
import math
import multiprocessing
import statistics
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache

from sidelong.mission.core.inputs import Input
from tests.faults.flight import FLAVOURS, FaultedFlight, Flown, Scenario
from tests.faults.flight_faults import BLINDING, EXPECTED_YIELDS, MISLEADING, Fault, drawn, yielding

# A clock that is off by seconds, and all that is stamped by it with it, misleads no one.
OWN_ERROR_MAX_M, TARGET_ERROR_MAX_M, CLOCK_ERROR_MAX_S = 60.0, 60.0, 15.0
RANGE_MIN_M, RANGE_MAX_M, RANGE_TOLERANCE_M = 100.0, 500.0, 5.0
TARGET_SPEED_M_S = 6.0  # a target that turns round while it is not seen: twice its own
MISLED_RANGE_MIN_M, REPORTED_WITHIN_S, WRONG_SHARE_MAX = 80.0, 15.0, 0.02
YIELD_WITHIN_S = 8.0
STEP_MAX_S = 0.05
PAYLOAD_INPUTS = (Input.LASER, Input.GIMBAL, Input.SIGHTINGS)
_TARGETS, _CAMPAIGN_TARGETS = 12, 96  # a fault meets one of this many; each is flown once without faults to compare


@dataclass(slots=True)
class Verdict:
    """One faulted flight. lost_on_side: how much less it was on the side than without faults, in points."""

    seed: int
    flavour: str
    names: tuple[str, ...]
    what: str
    broken: list[str] = field(default_factory=list)
    lost_on_side: float = 0.0
    slowest_step_s: float = 0.0
    misled: Misled | None = None


@dataclass(frozen=True, slots=True)
class Misled:
    """How a flight was misled by its payload.

    Attributes:
        alone: Whether there was no other fault.
        reported_s: Seconds until an input of the payload was reported; infinite if never.
        in_band_share: Share of the flight with a wrong claim to be in the band.
        on_side_share: The same of the side, beyond that of the flight without faults.
        nearest_m: Least true distance to the target.
    """

    alone: bool
    reported_s: float
    in_band_share: float
    on_side_share: float
    nearest_m: float


def judged(flown: Flown, alongside: Flown, faults: Sequence[Fault], ending: str | None, ending_s: float) -> list[str]:
    """Return what a flight broke, in words; ``alongside``: the same flight without faults."""
    blind_s = sum(one.end_s - one.begin_s for one in faults if one.name in BLINDING)  # nothing could be decided
    misled = [one for one in faults if one.name in MISLEADING]
    broken = []
    if misled:  # it follows a wrong target until the fault is found, and then none
        broken = _judged_misled(misled[0].name, misled_by(flown, alongside, misled[0], alone=len(faults) == 1))
    for decided in flown.decided if not misled else ():
        if not decided.own_error_m <= OWN_ERROR_MAX_M:
            broken.append(f"decided at {decided.time_s:.1f} s on a place {decided.own_error_m:.0f} m off")
        if not decided.target_error_m <= TARGET_ERROR_MAX_M + TARGET_SPEED_M_S * decided.unseen_s:
            broken.append(f"decided at {decided.time_s:.1f} s on a target {decided.target_error_m:.0f} m off")
        if abs(decided.clock_error_s) > CLOCK_ERROR_MAX_S:
            broken.append(f"decided at {decided.time_s:.1f} s on a clock {decided.clock_error_s:+.0f} s off")
    nearest_m, farthest_m = min(flown.range_m), max(flown.range_m)
    # No one can follow a target that moves on while nothing is known.
    tolerance_m = RANGE_TOLERANCE_M + 0.5 * TARGET_SPEED_M_S * blind_s
    if nearest_m < (MISLED_RANGE_MIN_M if misled else RANGE_MIN_M - tolerance_m):
        broken.append(f"came within {nearest_m:.0f} m")
    if farthest_m > RANGE_MAX_M + tolerance_m and not misled:
        broken.append(f"went {farthest_m:.0f} m away")
    if flown.outside_fence_m > 0.0:
        broken.append(f"left the fence by {flown.outside_fence_m:.0f} m")
    if flown.ended is not None:
        broken.append(f"ended: {flown.ended}")
    return broken[:4] + _judged_yield(flown, ending, ending_s)


def misled_by(flown: Flown, alongside: Flown, fault: Fault, *, alone: bool) -> Misled:
    """Return how far a fault of the payload misled a flight.

    After a turn of the target the claimed side is wrong for some seconds without any fault: these are subtracted.
    """
    reported_s = [at_s for at_s, one in flown.health if at_s > fault.begin_s and one.input in PAYLOAD_INPUTS]
    return Misled(
        alone,
        reported_s[0] - fault.begin_s if reported_s else math.inf,
        flown.wrongly_in_band_s / flown.scenario.duration_s,
        max(flown.wrongly_on_side_s - alongside.wrongly_on_side_s, 0.0) / flown.scenario.duration_s,
        min(flown.range_m),
    )


def _judged_misled(name: str, misled: Misled) -> list[str]:
    """Judge what a flight reports of itself; ``table`` counts those with other faults, too."""
    broken = []
    if misled.alone and misled.reported_s > REPORTED_WITHIN_S:
        broken.append(f"{name} reported after {misled.reported_s:.1f} s")
    if misled.alone and misled.in_band_share > WRONG_SHARE_MAX:
        broken.append(f"wrongly in band for {misled.in_band_share:.1%}")
    if misled.alone and misled.on_side_share > WRONG_SHARE_MAX:
        broken.append(f"wrongly on side for {misled.on_side_share:.1%}")
    return broken


def _judged_yield(flown: Flown, ending: str | None, ending_s: float) -> list[str]:
    if ending is None:
        return [f"yielded: {flown.yielded[1]}"] if flown.yielded is not None else []
    if flown.yielded is None:
        return [f"did not yield to: {ending}"]
    yielded_s, reason = flown.yielded
    if yielded_s < ending_s or yielded_s > ending_s + YIELD_WITHIN_S or EXPECTED_YIELDS[ending] not in reason:
        return [f"yielded {yielded_s - ending_s:+.1f} s from the {ending}: {reason}"]
    return []


@cache
def clean(scenario: Scenario) -> Flown:
    """Return the flight without faults."""
    return FaultedFlight(scenario).fly()


def flight(
    seed: int,
    flavour: str,
    faults: Sequence[Fault] | None = None,
    *,
    ending: tuple[str | None, float] = (None, math.inf),
    duration_s: float = 240.0,
    targets: int = _TARGETS,
) -> Verdict:
    """Fly one faulted flight and judge it; faults and ending: these instead of drawn ones."""
    scenario = Scenario(seed % targets, flavour, duration_s)
    if faults is None:
        faults, ending = drawn(seed, duration_s)
    faults, (ending_by, ending_s) = [*faults, *yielding(*ending)], ending
    what = "; ".join(f"{one.name} at {one.begin_s:.0f} s {one.what}".rstrip() for one in faults)
    verdict = Verdict(seed, flavour, tuple(one.name for one in faults), what)
    alongside = clean(scenario)
    loop = FaultedFlight(scenario, faults, time.thread_time)
    gc.collect()
    gc.freeze()  # what was loaded before is not searched again and again for garbage: 0.1 s each time
    loop.pilot_takes_over_s = ending_s if ending_by == "pilot" else loop.pilot_takes_over_s
    try:
        flown = loop.fly()
    except Exception:  # whatever it is, it is what is looked for
        verdict.broken.append(traceback.format_exc(limit=-3))
        return verdict
    verdict.broken = judged(flown, alongside, faults, ending_by, ending_s)
    misleading = [one for one in faults if one.name in MISLEADING]
    if misleading:
        verdict.misled = misled_by(flown, alongside, misleading[0], alone=len(faults) == 1)
    both = min(len(flown.on_side), len(alongside.on_side))
    verdict.lost_on_side = 100.0 * (statistics.mean(alongside.on_side[:both]) - statistics.mean(flown.on_side[:both]))
    verdict.slowest_step_s = flown.slowest_step_s
    return verdict


def _flight(order: tuple[int, str]) -> Verdict:
    return flight(*order, targets=_CAMPAIGN_TARGETS)


def campaign(flights: int, first_seed: int, processes: int) -> Iterable[Verdict]:
    """Yield the verdicts of this many flights, half of each flavour, on other targets than ``flight`` alone."""
    flavours = list(FLAVOURS)
    orders = [(first_seed + number, flavours[number % len(flavours)]) for number in range(flights)]
    if processes == 1:
        yield from map(_flight, orders)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_flight, orders, chunksize=4)


def _met(verdicts: list[Verdict], *, alone: bool) -> str:
    """Return how many flights that the payload misled meet each bar."""
    flown = [one.misled for one in verdicts if one.misled is not None and one.misled.alone is alone]
    if not flown:
        return ""
    reported = sum(one.reported_s <= REPORTED_WITHIN_S for one in flown)
    near = sum(one.nearest_m >= MISLED_RANGE_MIN_M for one in flown)
    band, side = (
        sum(getattr(one, share) <= WRONG_SHARE_MAX for one in flown) for share in ("in_band_share", "on_side_share")
    )
    return (
        f"{len(flown)} flights misled by the payload {'alone' if alone else 'and other faults'}: reported within "
        f"{REPORTED_WITHIN_S:.0f} s {reported}, no nearer than {MISLED_RANGE_MIN_M:.0f} m {near}, "
        f"wrongly in band at most {WRONG_SHARE_MAX:.0%} {band}, wrongly on side at most that {side}"
    )


def table(verdicts: Iterable[Verdict]) -> str:
    """Return the campaign's result, one line a fault, then what broke."""
    verdicts = list(verdicts)
    flights, broken = Counter(), Counter()
    lost: dict[str, list[float]] = defaultdict(list)
    for verdict in verdicts:
        for name in (*verdict.names, f"all of {verdict.flavour}"):
            flights[name] += 1
            broken[name] += bool(verdict.broken)
            lost[name].append(verdict.lost_on_side)
    lines = [f"{'fault':20}{'flights':>9}{'broken':>8}{'less on side, points':>22}"]
    lines += [
        f"{name:20}{count:9}{broken[name]:8}{statistics.mean(lost[name]):22.2f}"
        for name, count in sorted(flights.items())
    ]
    lines += [
        f"{verdict.flavour} {verdict.seed} ({verdict.what}): {'; '.join(verdict.broken)}"
        for verdict in verdicts
        if verdict.broken
    ]
    lines += [line for alone in (True, False) if (line := _met(verdicts, alone=alone))]
    slow = sum(verdict.slowest_step_s > STEP_MAX_S for verdict in verdicts)
    lines.append(f"{slow} flights with a step over {STEP_MAX_S * 1000.0:.0f} ms of processor time")
    return "\n".join(lines)

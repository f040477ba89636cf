"""What a configuration can be expected to achieve: its planner's own feasibility and a short simulated study."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sidelong.app.config import Config, with_values
from sidelong.app.errors import InputError
from sidelong.app.study.judging import RunResult
from sidelong.app.study.settings import OWN_PLANNERS, PREDICTIVE, StudySettings, configured, designs
from sidelong.app.study.study import ResultStore, one_flown, run_ids, table_of
from sidelong.estimators.compiled import FOLDER

FLIGHTS, FLIGHTS_MAX, FLIGHT_S = 20, 80, 600.0  # more flights while the verdict is in doubt
LEAST_IN_BAND, LEAST_ON_SIDE = 0.9, 0.6  # a configuration that stays below these is refused
KEPT = FOLDER / "predictions.sqlite"  # next to the machine code, and gone with it


def t_95(freedom: int) -> float:
    """Return Student's t for a two-sided interval of 95 %: a flight does not load scipy.

    With t = sqrt(freedom) tan(angle), its density over the angle is proportional to cos(angle) ** (freedom - 1).
    """
    angle_rad = np.linspace(0.0, math.pi / 2, 10_001)
    density = np.cos(angle_rad) ** (freedom - 1)
    share = np.cumsum(density[1:] + density[:-1])
    return math.sqrt(freedom) * math.tan(np.interp(0.95, share / share[-1], angle_rad[1:]))


@dataclass(frozen=True, slots=True)
class Share:
    """A share of the time, 0..1, over several flights: mean with its 95 % confidence interval, and the worst flight.

    A further flight is worse than that with a probability of 1 / (flights + 1).
    """

    mean: float
    low: float
    high: float
    worst: float

    @staticmethod
    def of(shares: Sequence[float]) -> Share | None:
        """Return the share over flights; None if it was not defined in at least two of them."""
        known = np.array([share for share in shares if not math.isnan(share)])
        if len(known) < 2:
            return None
        mean, worst = float(known.mean()), float(known.min())
        half = float(t_95(len(known) - 1) * known.std(ddof=1) / math.sqrt(len(known)))
        return Share(mean, max(mean - half, 0.0), min(mean + half, 1.0), worst)

    def __str__(self) -> str:
        mean, low, high, worst = (f"{100.0 * value:.1f}" for value in (self.mean, self.low, self.high, self.worst))
        return f"{mean} % (95 % interval {low} to {high} %, worst flight {worst} %)"


@dataclass(frozen=True, slots=True)
class Prediction:
    """Shares of time in simulated flights next to random targets; None: on side if none moved, pan without limits."""

    flights: int
    time_in_band: Share | None
    time_on_side: Share | None
    time_within_pan_limits: Share | None = None

    def shortcoming(self, config: Config) -> str:
        """Return what the configuration does not achieve and what to change, '' if it is good enough."""
        band, side, wanted = self.time_in_band, self.time_on_side, config.requirement
        if band is not None and band.high < LEAST_IN_BAND:
            return (
                f"in {self.flights} simulated flights the target is between {wanted.range_min_m:g} and "
                f"{wanted.range_max_m:g} m for {band}; widen the band, make aircraft.radius_m smaller "
                "or expect a slower target"
            )
        if side is not None and side.high < LEAST_ON_SIDE:
            return (
                f"in {self.flights} simulated flights the aircraft is on the required side for {side}; "
                "make aircraft.radius_m smaller, widen the band or expect a slower target"
            )
        return ""

    def doubt(self) -> str:
        """Return which share is too near to what is required for a verdict, '' if none is or one is too low."""
        shares = ("in band", self.time_in_band, LEAST_IN_BAND), ("on side", self.time_on_side, LEAST_ON_SIDE)
        known = [(name, share, least) for name, share, least in shares if share is not None]
        if any(share.high < least for _, share, least in known):
            return ""
        for name, share, least in known:
            if share.low < least <= share.high:
                return f"the time {name} is near the {100.0 * least:.0f} % that are required"
        return ""

    def as_json(self) -> dict[str, Any]:
        names = "time_in_band", "time_on_side", "time_within_pan_limits"
        shares: dict[str, Share | None] = {name: getattr(self, name) for name in names}
        shown = {name: None if share is None else asdict(share) for name, share in shares.items()}
        return {"flights": self.flights, "flight_s": FLIGHT_S, "in_doubt": bool(self.doubt()), **shown}


def studied(config: Config) -> StudySettings:
    """Return the study whose flights predict what a configuration achieves."""
    planner, autopilot = config.planner.name, config.simulation.autopilot
    base = StudySettings(planners=(planner,), runs=FLIGHTS, duration_s=FLIGHT_S, autopilot=autopilot)
    (design,) = designs(base, configured(config), [])
    together = with_values(design.settings.config, {"requirement": {"fleet_size": config.requirement.fleet_size}}, "")
    return replace(design.settings, config=together)


def predict(
    config: Config, progress: Callable[[float], None] = lambda _share: None, flights: int | None = None
) -> Prediction:
    """Fly a configuration that its planner can fly next to random targets, in the closed loop.

    Flights by planners of this package are kept: the same version does not fly them again.

    progress: called with the share 0..1 of the value table. flights: this many; None: until the verdict is clear.
    """
    settings = studied(config)
    (planner,) = settings.planners
    table = table_of(settings, progress) if planner == PREDICTIVE else None
    with closing(_kept_flights(planner)) as store:

        def fly(number: int) -> RunResult:
            runs = [*run_ids(replace(settings, only=(number,)), planner)]
            with suppress(sqlite3.Error):
                for _, kept in store.results(runs):
                    return kept
            found = one_flown(settings, planner, number, table)
            with suppress(InputError):  # no room on the disk
                store.add(zip(runs, [found], strict=True))
            return found

        return prediction_of(fly, flights)


def _kept_flights(planner: str) -> ResultStore:
    # The code of another distribution's planner can change without a sign.
    with suppress(InputError):
        return ResultStore(KEPT if planner in OWN_PLANNERS else None)
    return ResultStore()


def prediction_of(fly: Callable[[int], RunResult], flights: int | None = None) -> Prediction:
    """Fly runs by their numbers from 0: ``flights``, or until the verdict is clear, ``FLIGHTS_MAX`` at most."""
    flown: list[RunResult] = []
    while True:
        flown += [fly(number) for number in range(len(flown), len(flown) + (flights or FLIGHTS))]
        measured = [(one.time_in_band, one.time_on_side, one.time_within_pan_limits) for one in flown]
        found = Prediction(len(flown), *(Share.of(shares) for shares in zip(*measured, strict=True)))
        if flights or not found.doubt() or len(flown) >= FLIGHTS_MAX:
            return found

"""Which of the received lasers and gimbals are used, and why: rules of ``estimators.tracking.sources`` in words."""

from __future__ import annotations

from collections.abc import Sequence

from sidelong.app.assembly import tracker_settings
from sidelong.app.config import Config
from sidelong.estimators.sensing.readings import BEACON_MESSAGES, Source
from sidelong.estimators.tracking.sources import LOOKS_DOWN, Rank, range_rank, sight_rank

_AUTOPILOT_COMPONENT = 1


def describe_use(config: Config, kind: str, received: Sequence[Source]) -> dict[Source, str]:
    """Return what becomes of each source of a kind: range, gimbal, or target (a camera's own tracker)."""
    settings = tracker_settings(config.sensors, config.planner.lost_after_s)
    if kind == "target":
        return {
            source: "used: the target's own"
            if source.message in BEACON_MESSAGES
            else "used while no laser is received"
            for source in received
        }
    rank: Rank = range_rank if kind == "range" else sight_rank
    choice = settings.range_source if kind == "range" else settings.gimbal_source
    key = f"sensors.{kind}_component"
    if choice is not None:
        return {
            source: f"used: {key} names it" if choice.matches(source) else f"not used: {key} names another"
            for source in received
        }
    ranks = {source: own for source in received if (own := rank(source)) is not None}
    best = min(ranks.values(), default=None)
    first = [source for source, own in ranks.items() if own == best]
    return {source: _words(source, key, ranks, first) for source in received}


def _words(source: Source, key: str, ranks: dict[Source, int], first: Sequence[Source]) -> str:
    if source not in ranks:
        return f"not used: {'it looks down' if source.orientation == LOOKS_DOWN else 'a sensor of the autopilot'}"
    if source in first:
        if len(first) > 1:
            return f"used if it is received first; select one with {key}"
        return "used: " + ("the only one" if len(ranks) == 1 else "the payload's own, before what repeats it")
    repeats = source.component_id == _AUTOPILOT_COMPONENT
    why = "the autopilot only repeats it" if repeats else "it is not fixed to a gimbal"
    return f"stands by for when the other falls silent: {why}"

"""The summary of a flight for its report: the run's own, or one made from what was recorded."""

from __future__ import annotations

import math
from dataclasses import asdict
from itertools import dropwhile
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sidelong.app.analysis.score import Moment, score
from sidelong.app.analysis.summary import Summary
from sidelong.app.errors import InputError
from sidelong.app.report.history import History
from sidelong.app.report.series import estimate_errors

_SUMMARY = TypeAdapter(Summary)


def summary_of(history: History, outcome: str) -> Summary:
    """Return the summary of a flight that left none: it was cut off, or it is somebody else's log."""

    def outside(moment: Moment) -> bool:
        range_m = math.hypot(
            moment.aircraft_east_m - moment.target_east_m, moment.aircraft_north_m - moment.target_north_m
        )
        requirement = history.requirement_at(moment.time_s)
        return not requirement.range_min_m <= range_m <= requirement.range_max_m

    # Scored from the first moment in the band, like every run; from the first at all where there is none.
    moments = list(dropwhile(outside, history.moments)) or list(history.moments)
    source = "truth" if history.judged_by_truth else "estimate"
    errors = estimate_errors(history)
    return Summary(
        **asdict(score(moments, history.requirements, source)),  # type: ignore[arg-type]  # one of its two words
        moves=sum(change.departed_s is not None for change in history.plan_changes),
        uploads=len(history.plan_changes),
        upload_failures=sum(bool(change.failed) for change in history.plan_changes),
        sightings=len(history.sightings),
        rejected=sum(not outcome.accepted for outcome in history.sightings),
        estimate_rmse_m=None if errors is None else float(np.sqrt(np.mean(np.square(errors.error_m)))),
        outcome=outcome,
    )


def read_summary(values: dict[str, Any], name: str) -> Summary:
    """Return the summary that a run wrote, without what later programs add. Raises InputError by ``name``."""
    try:
        return _SUMMARY.validate_python(values, strict=False)
    except ValidationError as error:
        field = ".".join(map(str, error.errors()[0]["loc"]))
        raise InputError(f"{name}: its {field} is missing or wrong; delete the file to have it made anew.") from error


def rows(summary: Summary) -> list[tuple[str, str]]:
    """Return what the terminal shows of it, as (name, text)."""
    names, texts = summary.table().columns
    return [(str(name), str(text)) for name, text in zip(names.cells, texts.cells, strict=True)]

"""The summary of a flight for its report: the run's own, or one made from what was recorded."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sidelong.app.analysis.score import from_band, judge_moments, score
from sidelong.app.analysis.summary import Summary
from sidelong.app.errors import InputError
from sidelong.app.report.history import History
from sidelong.app.report.series import estimate_errors

_SUMMARY = TypeAdapter(Summary)


def summary_of(history: History, outcome: str) -> Summary:
    """Return the summary of a flight that left none: it was cut off, or it is another system's log."""
    asked, changes = history.requirements, history.plan_changes
    moments = from_band(history.moments, asked)
    judged = judge_moments(moments, asked)
    departures_s = [change.departed_s for change in changes if change.departed_s is not None]
    errors = estimate_errors(history)
    if history.judged_by_truth:
        scored = score(judged, "truth", departures_s)
    else:
        known = np.array([one.known for one in moments], dtype=bool)
        scored = score(judged, "estimate", departures_s, history.end_s, known)
    return Summary(
        **asdict(scored),
        uploads=len(changes),
        upload_failures=sum(bool(change.failed) for change in changes),
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
        raise InputError(f"{name}: its {field} is missing or wrong; delete it to have it written again.") from error

"""What is shown of the target while it is seen, and while it is not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sidelong.app.study.recorded import recorded_targets
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.target_news import TargetNews, UnseenTarget

TRACKS = Path(__file__).parents[2] / "app" / "study" / "tracks"


def announced(*seen: tuple[float, float, TrackQuality]) -> list[str]:
    """Return the texts; each of seen is a time, that of the latest sighting, and the track's quality."""
    news, texts = TargetNews(), []
    for time_s, sighted_s, quality in seen:
        estimate = TargetEstimate(time_s, 0.0, 0.0, 1.0, 0.0, np.eye(4), quality, sighted_s)
        texts += [one.text for one in news.announce(time_s, estimate)]
    return texts


@pytest.mark.parametrize("drop_out_s", [2.0, 4.0, 8.0])
def test_a_short_drop_out_is_no_news(drop_out_s):
    away = [(s, 10.0, TrackQuality.COASTING) for s in np.arange(10.5, 10.0 + drop_out_s + 0.1, 0.5)]
    seen_again = (20.0, 20.0, TrackQuality.GOOD)
    assert announced((10.0, 10.0, TrackQuality.GOOD), *away, seen_again) == ["the target is in sight"]


def test_a_long_one_is_reported_once_and_so_are_its_end_and_a_loss():
    seconds = range(10, 100)
    coasting = [(float(s), 10.0, TrackQuality.COASTING if s < 80 else TrackQuality.LOST) for s in seconds]
    texts = announced((10.0, 10.0, TrackQuality.GOOD), *coasting, (100.0, 100.0, TrackQuality.GOOD))
    assert texts == [
        "the target is in sight",
        "the target has not been seen for 9 s; its track goes on by its last motion",
        "the target is lost: not seen for 70 s; searching for it",
        "the target is in sight again",
    ]


@pytest.mark.parametrize("ahead_s", [30.0, 60.0, 120.0, 180.0])
def test_unseen_recorded_targets_are_where_they_are_predicted(ahead_s):
    errors = []  # as shares of the radius
    for target in recorded_targets([TRACKS], 9.0).flown:
        limit_m_s = 5.0 if target.speed_p95_m_s <= 5.0 else 9.0
        for begin_s in np.arange(0.0, target.duration_s - ahead_s - 120.0, 60.0):
            tracker = SimpleNamespace(last_seen=None)
            unseen = UnseenTarget(tracker)
            for time_s in np.arange(begin_s, begin_s + 121.0, 4.0):
                at = target.at(time_s)
                state = at.east_m, at.north_m, at.velocity_east_m_s, at.velocity_north_m_s
                seen = TargetEstimate(time_s, *state, np.eye(4), TrackQuality.GOOD, time_s)
                unseen.note(seen, limit_m_s)
            tracker.last_seen = seen
            later = TargetEstimate(time_s + ahead_s, *state, 1e6 * np.eye(4), TrackQuality.LOST, time_s)
            disk, at = unseen.density(unseen.predicted(later, limit_m_s, 60.0)), target.at(time_s + ahead_s)
            errors.append(math.hypot(disk.east_m - at.east_m, disk.north_m - at.north_m) / disk.radius_m)
    assert np.mean(np.array(errors) <= 1.0) >= 0.93
    assert np.mean(errors) > 0.25  # the disk is not far too large


def test_a_target_that_was_seen_before_the_first_decision_only_is_somewhere():
    seen = TargetEstimate(10.0, 0.0, 0.0, 1.0, 0.0, np.eye(4), TrackQuality.GOOD, 10.0)
    unseen = UnseenTarget(SimpleNamespace(last_seen=seen))
    later = replace(seen, time_s=70.0, quality=TrackQuality.LOST)
    assert unseen.density(unseen.predicted(later, 5.0, 60.0)).radius_m < 5.0 * 60.0 * 1.1

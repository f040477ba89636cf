"""What is shown of the target while it is seen, and while it is not."""

from __future__ import annotations

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.target_news import TargetNews


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
        "the target is lost: not seen for 70 s; holding the circle",
        "the target is in sight again",
    ]

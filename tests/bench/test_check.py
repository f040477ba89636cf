"""What ``check`` predicts of random configurations, compared with as many flights of each next to other targets.

``CHECKED=200 python -m pytest tests/bench/test_check.py -s``
"""

from __future__ import annotations

import numpy as np
import pytest

from sidelong.app.config import Config, unflyable
from sidelong.app.errors import InputError
from sidelong.app.study.closed_loop import run
from sidelong.app.study.prediction import FLIGHTS_MAX, Prediction, Share, predict, prediction_of, studied
from sidelong.app.study.settings import (
    PREDICTIVE,
)
from sidelong.app.study.study import table_of
from tests.bench.size import size

CHECKED = size(200, 2, "CHECKED")


def random_config(rng: np.random.Generator) -> Config:
    """Return a configuration that an operator could write; many of them are hard, some cannot be flown."""
    airspeed_m_s = float(rng.uniform(10.0, 25.0))
    range_min_m = float(rng.uniform(60.0, 200.0))
    values = {
        "aircraft": {"airspeed_m_s": airspeed_m_s, "radius_m": float(rng.uniform(0.8, 1.6) * airspeed_m_s**2 / 4.0)},
        "requirement": {
            "side": str(rng.choice(["left", "right"])),
            "range_min_m": range_min_m,
            "range_max_m": range_min_m + float(rng.uniform(150.0, 600.0)),
            "target_speed_max_m_s": float(rng.uniform(0.05, 0.45)) * airspeed_m_s,
        },
        "simulation": {
            "autopilot": str(rng.choice(["px4", "arduplane"])),
            "wind_speed_m_s": float(rng.uniform(0.0, 0.3)) * airspeed_m_s,
        },
    }
    return Config.model_validate(values)


def flown(config: Config) -> Prediction:
    """Return what flights in the closed loop come to, by the same rule, next to other targets."""
    settings = studied(config)
    table = table_of(settings)
    return prediction_of(lambda number: run(settings, PREDICTIVE, FLIGHTS_MAX + number, table))


def verdict(prediction: Prediction, config: Config) -> str:
    return "refused" if prediction.shortcoming(config) else "close" if prediction.doubt() else "good"


def shares(prediction: Prediction) -> tuple[Share | None, Share | None]:
    return prediction.time_in_band, prediction.time_on_side


def test_launch_achieves_what_check_predicts():
    rng, refused, within, verdicts = np.random.default_rng(1), 0, [], []
    while len(verdicts) + refused < CHECKED:
        try:
            config = random_config(rng)
        except ValueError:
            continue
        if unflyable(config):
            with pytest.raises(InputError):
                studied(config)
            refused += 1
            continue
        predicted, achieved = predict(config), flown(config)
        verdicts.append((verdict(predicted, config), verdict(achieved, config)))
        for said, done in zip(shares(predicted), shares(achieved), strict=True):
            if said is not None and done is not None:
                within.append((said.low <= done.mean <= said.high, done.mean >= said.worst))
            if verdicts[-1][0] != verdicts[-1][1] or (within and not within[-1][1]):
                print(f"{len(verdicts)}, {verdicts[-1]}: predicted {said}; flown {done}", flush=True)
    in_interval, above_worst = np.mean(within, axis=0)
    same, opposite = sum(a == b for a, b in verdicts), sum({a, b} == {"good", "refused"} for a, b in verdicts)
    print(
        f"\n{len(verdicts)} flown, {refused} that cannot be flown refused by both; verdicts the "
        f"same in {same}, opposite in {opposite}; of {len(within)} shares the mean flown is in the interval in "
        f"{in_interval:.1%}, above the worst flight in {above_worst:.1%}"
    )
    assert above_worst >= 0.9
    assert opposite == 0

"""What ``check`` predicts of random configurations, compared with as many flights of each in the closed loop.

``CHECKED=200 python -m pytest tests/bench/test_check.py -s``
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.config import Config, unflyable
from sidelong.app.errors import InputError
from sidelong.app.study.closed_loop import run_closed_loop
from sidelong.app.study.prediction import FLIGHTS, Prediction, Share, predict, studied
from sidelong.app.study.settings import Fidelity, PlannerName
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
    """Return what as many flights in the closed loop come to, next to other targets than those of the prediction."""
    settings = replace(studied(config), fidelity=Fidelity.CLOSED_LOOP)
    table, numbers = table_of(settings), range(FLIGHTS, 2 * FLIGHTS)
    flights = [run_closed_loop(settings, PlannerName.PREDICTIVE, number, table) for number in numbers]
    band, side = [one.time_in_band for one in flights], [one.time_on_side for one in flights]
    return Prediction(Share.of(band), Share.of(side))


def shares(prediction: Prediction) -> tuple[Share | None, Share | None]:
    return prediction.time_in_band, prediction.time_on_side


def test_launch_achieves_what_check_predicts():
    rng, refused, within, agreed = np.random.default_rng(1), 0, [], []
    while len(agreed) + refused < CHECKED:
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
        agreed.append(bool(predicted.shortcoming(config)) == bool(achieved.shortcoming(config)))
        for said, done in zip(shares(predicted), shares(achieved), strict=True):
            if said is not None and done is not None:
                within.append((said.low <= done.mean <= said.high, done.mean >= said.worst))
            if not (agreed[-1] and within[-1][1]):
                print(f"{'agreed' if agreed[-1] else 'NOT AGREED'}: predicted {said}; flown {done}", flush=True)
    in_interval, above_worst = np.mean(within, axis=0)
    print(
        f"\n{len(agreed)} flown, {refused} that cannot be flown refused by both; verdicts agree in {sum(agreed)}; "
        f"of {len(within)} shares the mean flown is in the interval in {in_interval:.1%}, above the worst flight in "
        f"{above_worst:.1%}"
    )
    assert above_worst >= 0.9
    assert np.mean(agreed) >= 0.9

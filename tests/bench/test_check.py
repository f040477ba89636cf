"""What ``check`` predicts of random configurations, compared with a flight of each in the closed loop.

``CHECKED=200 python -m pytest tests/bench/test_check.py -s``
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.config import Config, unflyable
from sidelong.app.errors import InputError
from sidelong.app.study.closed_loop import run_closed_loop
from sidelong.app.study.prediction import FLIGHTS, LEAST_IN_BAND, LEAST_ON_SIDE, predict, studied
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


def test_launch_achieves_what_check_predicts():
    rng, flown, refused, within, agreed = np.random.default_rng(1), 0, 0, [], []
    while flown + refused < CHECKED:
        try:
            config = random_config(rng)
        except ValueError:
            continue
        if unflyable(config):
            with pytest.raises(InputError):
                studied(config)
            refused += 1
            continue
        flown += 1
        prediction = predict(config)
        settings = replace(studied(config), fidelity=Fidelity.CLOSED_LOOP)
        result = run_closed_loop(settings, PlannerName.PREDICTIVE, FLIGHTS, table_of(settings))  # a target of its own
        achieved = {"band": result.time_in_band, "side": result.time_on_side}
        predicted = {"band": prediction.time_in_band, "side": prediction.time_on_side}
        for name, share in predicted.items():
            if share is not None and not math.isnan(achieved[name]):
                within.append(achieved[name] >= share.worst - 1e-9)
                if not within[-1]:
                    print(f"{name}: {100.0 * achieved[name]:.1f} %, predicted {share}: {config.aircraft}")
        fails = achieved["band"] < LEAST_IN_BAND or achieved["side"] < LEAST_ON_SIDE
        agreed.append(bool(prediction.shortcoming(config)) == fails)
    print(
        f"\n{flown} flown, {refused} that cannot be flown are refused by both; verdicts agree in {sum(agreed)}; "
        f"{sum(within)} of {len(within)} shares not below the predicted worst flight"
    )
    assert np.mean(within) >= 0.9
    assert np.mean(agreed) >= 0.9

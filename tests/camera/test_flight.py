"""One short flight from pixels alone, in the closed loop; tests/bench/test_pixels.py flies the campaign."""

from __future__ import annotations

import numpy as np

from sidelong.app.config import Config
from tests.camera.flight import PixelFlight, settings_of


def test_the_target_is_watched_from_the_side_by_its_pictures_alone():
    config = Config.model_validate({"terrain": {"flat": True}, "requirement": {"target_speed_max_m_s": 3.5}})
    pixels = PixelFlight(config, settings_of("arduplane", "straight", 1, trees=0.3, lookalikes=0.3)).fly(60.0)
    assert np.mean(pixels.in_picture) > 0.98
    assert np.mean(pixels.in_middle) > 0.95
    assert np.nanmedian(pixels.off_m) < 5.0
    assert pixels.score.time_in_band == 1.0

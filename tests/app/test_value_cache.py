from dataclasses import replace

import numpy as np
import pytest

from app.value_cache import value_table
from mission.cost import WatchCost
from mission.value_table import TableConfiguration

# Coarse and hardly improved, so that it takes about a second.
SMALL = TableConfiguration(10.0, 50.0, 0.0008, 5.0, WatchCost.inside(100.0, 500.0), cells=4, improvements=(1, 1))


def test_a_table_is_computed_once_with_progress(tmp_path):
    shares = []
    first = value_table(SMALL, shares.append, tmp_path)
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < shares[-1] <= 1.0
    again = value_table(SMALL, lambda share: pytest.fail("computed again"), tmp_path)
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(first.after_turn, again.after_turn)


def test_a_damaged_file_is_computed_anew(tmp_path):
    first = value_table(SMALL, directory=tmp_path)
    (file,) = tmp_path.iterdir()
    for content in (b"", file.read_bytes()[:1000]):
        file.write_bytes(content)
        np.testing.assert_array_equal(value_table(SMALL, directory=tmp_path).values, first.values)


def test_another_configuration_has_another_file(tmp_path):
    value_table(SMALL, directory=tmp_path)
    value_table(replace(SMALL, target_speed_max_m_s=6.0), directory=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_directory_that_cannot_be_written_costs_only_time(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert value_table(SMALL, directory=blocked / "below").values.shape[0] == 3

from dataclasses import replace

import numpy as np
import pytest

from app.value_cache import value_table
from mission.predictive.cost import WatchCost
from mission.predictive.value_table import TableConfiguration

# Coarse and hardly improved, so that it takes about a second.
SMALL = TableConfiguration(10.0, 50.0, 0.0008, 5.0, WatchCost.inside(100.0, 500.0), cells=4, improvements=(1, 1))


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Return a table, the folder that keeps it, and the progress that was told."""
    shares, folder = [], tmp_path_factory.mktemp("tables")
    return value_table(SMALL, shares.append, folder), folder, shares


def test_a_table_is_computed_once_with_progress(computed):
    first, folder, shares = computed
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < shares[-1] <= 1.0
    again = value_table(SMALL, lambda share: pytest.fail("computed again"), folder)
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(first.after_turn, again.after_turn)


@pytest.mark.parametrize("length", [0, 1000])
def test_a_damaged_file_is_computed_anew(computed, tmp_path, length):
    first, folder, _ = computed
    (whole,) = folder.iterdir()
    (tmp_path / whole.name).write_bytes(whole.read_bytes()[:length])
    np.testing.assert_array_equal(value_table(SMALL, directory=tmp_path).values, first.values)
    assert (tmp_path / whole.name).read_bytes() == whole.read_bytes()


def test_another_configuration_has_another_file(computed, tmp_path):
    (whole,) = computed[1].iterdir()
    value_table(replace(SMALL, target_speed_max_m_s=6.0), directory=tmp_path)
    (other,) = tmp_path.iterdir()
    assert other.name != whole.name


def test_a_directory_that_cannot_be_written_costs_only_time(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert value_table(SMALL, directory=blocked / "below").values.shape[0] == 3

import os
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.planners.value_cache import _store, value_table
from sidelong.mission.predictive.value_table import TableConfiguration, WatchCost

# Coarse and hardly improved, so that it takes about a second.
SMALL = TableConfiguration(
    10.0, 50.0, 50.0, 0.0008, 5.0, WatchCost.inside(100.0, 500.0), cells=4, improvements=(1, 1)
)


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Return a table, the folder that keeps it, and the progress that was reported."""
    shares, folder = [], tmp_path_factory.mktemp("tables")
    return value_table(SMALL, shares.append, folder), folder, shares


def test_a_table_is_computed_once_with_progress(computed):
    first, folder, shares = computed
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < shares[-1] <= 1.0
    again = value_table(SMALL, lambda share: pytest.fail("computed again"), folder)
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(first.after_turn, again.after_turn)


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0x01]) + data[at + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:1000],
        lambda data: data + b"\0",
        lambda data: flipped(data, 0),
        lambda data: flipped(data, len(data) // 2),
        lambda data: bytes(len(data)),
    ],
    ids=["empty", "cut", "longer", "checksum flipped", "value flipped", "zeros"],
)
def test_a_damaged_file_is_computed_again(computed, tmp_path, damage):
    first, folder, _ = computed
    (whole,) = folder.iterdir()
    (tmp_path / whole.name).write_bytes(damage(whole.read_bytes()))
    shares = []
    np.testing.assert_array_equal(value_table(SMALL, shares.append, tmp_path).values, first.values)
    assert shares
    assert (tmp_path / whole.name).read_bytes() == whole.read_bytes()


def test_a_table_of_another_configuration_is_not_taken(computed, tmp_path):
    (whole,) = computed[1].iterdir()
    other = replace(SMALL, target_speed_max_m_s=6.0)
    (tmp_path / f"value-{other.key()}.table").write_bytes(whole.read_bytes())
    shares = []
    value_table(other, shares.append, tmp_path)
    assert shares


def test_a_user_without_a_home_keeps_tables_in_the_temporary_folder(tmp_path):
    program = """
from pathlib import Path
from unittest.mock import Mock
Path.home = Mock(side_effect=RuntimeError("Could not determine home directory."))
from sidelong.app.planners.value_cache import DIRECTORY
(DIRECTORY / "value.table").touch()
print(DIRECTORY)
"""
    none = {"HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"}
    environment = {name: value for name, value in os.environ.items() if name not in none} | {"TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60.0)
    assert Path(done.stdout.strip()) == tmp_path / f"sidelong-{os.getuid()}"


def test_a_full_disk_costs_only_time_and_leaves_nothing(computed, tmp_path):
    table, directory = computed[0], tmp_path / "tables"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # a write beyond it fails as on a full disk
    try:
        _store(directory / "value.table", table)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(directory.iterdir())


def test_another_configuration_has_another_file(computed, tmp_path):
    (whole,) = computed[1].iterdir()
    value_table(replace(SMALL, target_speed_max_m_s=6.0), directory=tmp_path)
    (other,) = tmp_path.iterdir()
    assert other.name != whole.name


def test_a_directory_that_cannot_be_written_costs_only_time(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert value_table(SMALL, directory=blocked / "below").values.shape[0] == 3

"""Damaged files, a hundred of every kind; tests/bench/test_faults.py has a million."""

from __future__ import annotations

import pytest

from tests.faults.campaign import Count, run

INPUTS = 100
NAMES = (
    *("tlog", "ulog", "dataflash", "journal", "journal, sealed", "truth", "summary", "config"),
    *("gpx", "csv track", "ais table", "kml", "kmz", "geojson", "plan", "waypoints", "drawn line, CoT"),
    *("tile, zipped", "geotiff"),
    *("fleet", "beacon, CoT", "beacon, FOLLOW_TARGET", "mbtiles", "pmtiles", "value table"),
)


@pytest.fixture(scope="module")
def counts() -> dict[str, Count]:
    return {count.reader: count for count in run(INPUTS, campaign=12, processes=1)}


def test_every_reader_takes_part(counts):
    assert sorted(counts) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_file_is_one_sentence_or_read_as_far_as_it_is_whole(counts, name):
    assert counts[name].inputs == INPUTS
    assert not counts[name].faults

"""Benchmarks take the time they take; in a smoke run (see size.py) their verdicts do not count."""

import traceback
from pathlib import Path

import pytest

from tests.bench.size import SMOKE

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.is_relative_to(HERE):
            item.add_marker(pytest.mark.timeout(0))


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    try:
        return (yield)
    except AssertionError as error:
        # A few samples prove no bound. Every other error counts, and so does an assertion of anything else.
        if not SMOKE or Path(traceback.extract_tb(error.__traceback__)[-1].filename) != pyfuncitem.path:
            raise
        return True

"""What all tests share: compiled code, and ports that no other process of the suite is about to use."""

from __future__ import annotations

import fcntl
import functools
import gc
import itertools
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Generator

import pytest
from hypothesis import settings

from sidelong.estimators import compiled
from tests.autopilot.matrix import pytest_runtest_makereport, pytest_terminal_summary  # noqa: F401  # hooks

# Workers and the commands that tests start read the bytecode of the checkout; each would compile all of it again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
gc.disable()  # collecting the tests makes objects that stay: looking for garbage takes a third of that time

# Where it decides over a change, the same examples are tried each time; at a desk Hypothesis may look for new ones.
settings.register_profile("ci", derandomize=True, deadline=None, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

# Below the ports that systems give away by themselves: one of those may go to another socket before it is used.
_FIRST, _COUNT = 12_000, 16_000
_ports = itertools.count(101 * os.getpid())  # processes begun one after the other are a hundred ports apart


# The planner and the filter, which every flight loads from disk once they are compiled.
_COMPILE = (
    "from sidelong.app.assembly import controller_of; from sidelong.app.config import Config; controller_of(Config())"
)
# One of two workers begins with these, in this order: first those that need no compiled planner, while the other one
# compiles it, then those that compile the studies' loop, which the other one loads later.
_PLAIN = ("tests/sitl/", "tests/records/", "tests/payload/", "tests/app/test_view", "tests/exchange/")
_EARLY = (*_PLAIN, "tests/app/test_study", "tests/app/test_prediction", "tests/app/test_fleet_commands")


def pytest_collection_finish(session: pytest.Session) -> None:
    gc.enable()
    gc.freeze()


@pytest.hookimpl(wrapper=True, tryfirst=True)  # the time does not count against the test's limit
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    if hasattr(item.config, "workerinput") and (_waits(item) or not item.nodeid.startswith(_PLAIN)):
        _compile_once()
    return (yield)


@functools.cache
def _compile_once() -> None:
    """Compile before the first flight of a worker; other workers that need it wait, and do not compile it too."""
    folder = os.open(compiled.FOLDER, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        subprocess.run([sys.executable, "-c", _COMPILE], check=True)
    finally:
        os.close(folder)


def _waits(item: pytest.Item) -> bool:
    return item.get_closest_marker("udp") is not None


@pytest.fixture(scope="session")
def free_port() -> Callable[[], int]:
    """Return what gives UDP ports of the loopback, a new one each time."""

    def free() -> int:
        while True:
            port = _FIRST + next(_ports) % _COUNT
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                try:
                    probe.bind(("127.0.0.1", port))
                except OSError:
                    continue
                return port

    return free


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give one of two workers what waits for the clock, so that the other one computes next to it.

    Of that, what shares a flight comes first: the last ones may be stolen one by one by an idle worker. The tests of
    the other worker begin at half of the list.
    """

    def rank(item: pytest.Item) -> tuple[bool, bool]:
        return not _waits(item), "autopilot" in item.path.parts

    early = [item for start in _EARLY for item in items if item.nodeid.startswith(start) and not _waits(item)]
    others = sorted((item for item in items if _waits(item) or not item.nodeid.startswith(_EARLY)), key=rank)
    half = len(items) // 2
    items[:] = others[:half] + early + others[half:]

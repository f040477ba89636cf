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

from sidelong.app.study.settings import PREDICTIVE
from sidelong.app.study.study import is_compiled
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
_COMPILE = "from sidelong.app.assembly import prepared; from sidelong.app.config import Config; prepared(Config())"
# The computing worker begins with these, in this order: first those that need no compiled planner or filter, while
# another worker compiles them, then those that compile the studies' loop, which the others load later.
_PLAIN = ("tests/sitl/", "tests/payload/", "tests/records/")
_NOT_PLAIN = (
    "tests/payload/test_flight",
    "tests/payload/test_pointing",
    "tests/records/test_klv",
    "tests/records/test_log",
)
# Fleets come early among them: two workers that need the fleet's planner at the same time would both compile it.
_STUDIES = (
    "tests/app/test_fleet_commands",
    "tests/app/test_study_fleet",
    "tests/app/test_warm_up",
    "tests/app/test_study",
    "tests/app/test_prediction",
)
# Then the longest of those that compute: begun at the end, one of them would leave the other workers idle.
_LONG = (
    *("tests/test_bench_smoke", "tests/test_examples", "tests/test_package", "tests/camera/test_flight"),
    *("tests/mission/test_eights", "tests/exchange/test_fleet", "tests/faults/test_envelope"),
)
# Of those that wait for the clock, the second worker takes these.
_SECOND = ("tests/autopilot/", "tests/serve/", "tests/faults/test_public_reports")


def pytest_collection_finish(session: pytest.Session) -> None:
    gc.enable()
    gc.freeze()


@pytest.hookimpl(wrapper=True, tryfirst=True)  # the time does not count against the test's limit
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    if hasattr(item.config, "workerinput") and not _is_plain(item):
        _compile_once()
    return (yield)


@functools.cache
def _compile_once() -> None:
    """Compile before the first flight of a worker; other workers that need it wait, and do not compile it too."""
    folder = os.open(compiled.FOLDER, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        if not is_compiled(PREDICTIVE):
            subprocess.run([sys.executable, "-c", _COMPILE], check=True)
    finally:
        os.close(folder)


def _waits(item: pytest.Item) -> bool:
    return item.get_closest_marker("udp") is not None


def _is_plain(item: pytest.Item) -> bool:
    return item.nodeid.startswith(_PLAIN) and not item.nodeid.startswith(_NOT_PLAIN)


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


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Give the first two workers the tests that wait for the clock, so that the others compute in the meantime.

    Each worker begins with an equal share of the list; an idle worker then steals from the end of another's share. So
    what waits, and shares its flights, comes first in a share.
    """
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    if workers == 1:
        return
    waiting, working = ([item for item in items if _waits(item) == waits] for waits in (True, False))
    # Those that need no planner keep the second worker busy while the first one compiles it.
    second = [item for item in waiting if _is_plain(item)]
    second += [item for item in waiting if item.nodeid.startswith(_SECOND)]
    # The slow start of an installed program comes first, and a fleet last: by then the studies have compiled it.
    order = {"test_package.py": 0, "test_fleet.py": 2}
    first = sorted((item for item in waiting if item not in second), key=lambda item: order.get(item.path.name, 1))
    early = [item for start in _PLAIN for item in working if item.nodeid.startswith(start) and _is_plain(item)]
    later = (*_STUDIES, *_LONG)
    early += dict.fromkeys(item for start in later for item in working if item.nodeid.startswith(start))
    taken = set(early)
    others = [item for item in working if item not in taken]
    share = -(-len(items) // workers)  # of the last worker
    others += early[share:]
    between: list[list[pytest.Item]] = [[] for _ in range(workers - 3)]
    heads = [first, second, *between] if workers > 2 else [first + second]
    total = len(items)
    items.clear()
    for number, head in enumerate([*heads, early[:share]]):
        room = max((total - len(items)) // (workers - number) - len(head), 0)
        items += head + others[:room]
        del others[:room]

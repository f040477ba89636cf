"""What all tests share: compiled code, and ports that no other process of the suite is about to use."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
from collections.abc import Callable

import pytest
from hypothesis import settings

from tests.autopilot.matrix import pytest_runtest_makereport, pytest_terminal_summary  # noqa: F401  # hooks

# Where it decides over a change, the same examples are tried each time; at a desk Hypothesis may look for new ones.
settings.register_profile("ci", derandomize=True, deadline=None, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

# Below the ports that systems give away by themselves: one of those may go to another socket before it is used.
_FIRST, _COUNT = 12_000, 16_000
_ports = itertools.count(101 * os.getpid())  # processes begun one after the other are a hundred ports apart


# The planner and the filter, which every flight loads from disk once someone has compiled them.
_COMPILED = (
    "from sidelong.app.assembly import controller_of; from sidelong.app.config import Config; controller_of(Config())"
)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile before several workers begin: each of them would do it again, in a flight that is waited for."""
    config = session.config
    if config.option.collectonly or not getattr(config.option, "numprocesses", None):
        return
    subprocess.run([sys.executable, "-c", _COMPILED], cwd=config.rootpath, check=True)


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
    """Begin with what waits for the clock: next to it another process computes, and both end at about the same time.

    Of that, what shares a flight comes first: the last ones may be taken over one by one by whoever has time.
    """

    def rank(item: pytest.Item) -> tuple[bool, bool]:
        return item.get_closest_marker("udp") is None, "autopilot" in item.path.parts

    items.sort(key=rank)

"""Python's search path, so that files of the same name in a user's folders do not replace our modules.

A drone workspace may well have a ``mission.py`` or a ``numpy.py``, and ROS puts its folders on PYTHONPATH, which
Python searches before installed packages.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import sidelong


def prefer_installed_packages() -> None:
    """Search PYTHONPATH and the working folder after installed packages, except where sidelong itself is there."""
    own = str(Path(sidelong.__file__).parents[1])
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    last = {os.path.abspath(folder) for folder in named} | {os.getcwd()}  # noqa: PTH100, PTH109  # may not exist
    last -= {own}
    sys.path.sort(key=lambda folder: os.path.abspath(folder) in last)  # noqa: PTH100


def helper_command(module: str, *arguments: str) -> tuple[str, ...]:
    """Return the command line that runs one of our modules as a process of its own."""
    return (sys.executable, "-P", "-m", module, *arguments)


def helper_environment() -> dict[str, str]:
    """Return the environment of such a process: ours, with this process's search path in its order."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)}

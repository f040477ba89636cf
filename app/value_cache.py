"""Value tables on disk: computed once per configuration, then read in milliseconds."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mission.predictive.value_iteration import compute
from mission.predictive.value_table import TableConfiguration, ValueTable, completed


def cache_directory() -> Path:
    """Return where tables are kept: $XDG_CACHE_HOME/sidelong, else ~/.cache/sidelong."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sidelong"


def value_table(
    configuration: TableConfiguration,
    progress: Callable[[float], None] = lambda _share: None,
    directory: Path | None = None,
) -> ValueTable:
    """Return the table from its file; compute and store it when there is none or it cannot be read.

    progress is called with the share 0..1 of the computation. A directory that cannot be written costs only time.
    """
    file = (directory or cache_directory()) / f"value-{configuration.key()}.npy"
    try:
        return completed(configuration, np.load(file, allow_pickle=False))
    except (OSError, ValueError, EOFError):
        table = compute(configuration, progress)
        _store(file, table)
        return table


def _store(file: Path, table: ValueTable) -> None:
    """Write under another name first: a reader meets a whole file or none."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as part:
            np.save(part, table.values)
        Path(part.name).replace(file)
    except OSError:
        return

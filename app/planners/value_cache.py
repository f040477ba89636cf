"""Value tables on disk: computed once per configuration, then read in milliseconds.

A file is the SHA-256 of key and values, then these as little-endian 32-bit floats; any other is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from sidelong.app.process import helper_command, helper_environment
from sidelong.estimators.compiled import FOLDER
from sidelong.mission.predictive.value_table import Float32, TableConfiguration, ValueTable, completed, compute

_REMEMBERED_MAX = 8
_IN_PARALLEL_WITHIN_S, _NICER = 120.0, 10
DIRECTORY = FOLDER.parent  # where tables are kept: next to the machine code

_remembered: dict[TableConfiguration, ValueTable] = {}  # by this process
_STORED = np.dtype("<f4")
_DIGEST_BYTES = hashlib.sha256().digest_size


def value_table(
    configuration: TableConfiguration,
    progress: Callable[[float], None] = lambda _share: None,
    directory: Path | None = None,
) -> ValueTable:
    """Return the table from its file; compute and store it if there is none or it is not whole, with a share 0..1."""
    if configuration in _remembered:
        return _remembered[configuration]
    file = (directory or DIRECTORY) / f"value-{configuration.key()}.table"
    values = stored_table(file, configuration)
    if values is not None:
        return completed(configuration, values)
    table = compute(configuration, progress)
    _store(file, table)
    return table


async def have_at_hand(configurations: Iterable[TableConfiguration]) -> None:
    """Have tables ready in this process: another one reads or computes them. Raises OSError when that fails."""
    for configuration in configurations:
        if configuration not in _remembered:
            table = await _made_in_parallel(configuration)
            while len(_remembered) >= _REMEMBERED_MAX:
                del _remembered[next(iter(_remembered))]
            _remembered[configuration] = table


async def _made_in_parallel(configuration: TableConfiguration) -> ValueTable:
    import asyncio  # noqa: PLC0415  # in a flight it is loaded already; reading a table does not need it

    process = await asyncio.create_subprocess_exec(
        *helper_command("sidelong.app.planners.value_cache"),
        env=helper_environment(),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # the terminal's Ctrl-C is not for it
    )
    try:
        made, _ = await asyncio.wait_for(process.communicate(pickle.dumps(configuration)), _IN_PARALLEL_WITHIN_S)
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    if process.returncode:
        raise OSError(f"the value table's computation ended with code {process.returncode}")
    table: ValueTable = pickle.loads(made)
    return table


def stored_table(file: Path, configuration: TableConfiguration) -> Float32 | None:
    """Return the values that a file holds; None when it is not whole, or of another configuration."""
    shape = configuration.shape
    size = _DIGEST_BYTES + int(np.prod(shape)) * _STORED.itemsize
    try:
        if file.stat().st_size != size:
            return None
        data = file.read_bytes()
    except OSError:
        return None
    digest, values = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if digest != _digest(configuration, values):
        return None
    return np.frombuffer(values, _STORED).reshape(shape).astype(np.float32)


def _digest(configuration: TableConfiguration, values: bytes) -> bytes:
    return hashlib.sha256(configuration.key().encode() + values).digest()


def _store(file: Path, table: ValueTable) -> None:
    """Write under another name first: a reader meets a whole file or none."""
    values = table.values.astype(_STORED).tobytes()
    part: Path | None = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as out:
            part = Path(out.name)
            out.write(_digest(table.configuration, values) + values)
        part.replace(file)
    except OSError:
        if part is not None:
            part.unlink(missing_ok=True)


def _serve() -> None:
    os.nice(_NICER)  # a flight has the processor first
    sys.stdout.buffer.write(pickle.dumps(value_table(pickle.loads(sys.stdin.buffer.read()))))


if __name__ == "__main__":
    _serve()

"""How the inner loops are compiled: numba, without fast-math, kept on disk from one start to the next.

Compiled code lies beside its source where that can be written, else in the user's cache; NUMBA_CACHE_DIR names
another place. Where nothing can be written, each start compiles anew.

numba notices when a function's own file changes, not when one that it calls or a constant does: here the stamp of
what is kept covers all of them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from types import CodeType
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function of numbers, arrays and named tuples of them; see numba's subset of Python.

    Divisions by zero give infinities, as numpy's do. Operations keep their order, so that results are the same to
    the last bit in every process on machines of one kind.
    """
    dispatcher: Any
    try:
        dispatcher = numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no place to keep it
        return cast(F, numba.njit(error_model="numpy")(function))
    file = dispatcher._cache._cache_file
    file._source_stamp = dispatcher.stamp = f"{file._source_stamp!r} {_used(function)}"
    return cast(F, dispatcher)


def _used(function: Callable[..., Any]) -> str:
    """Return a hash of the globals that a function uses: stamps of compiled functions, and values of constants."""
    found = hashlib.sha256()
    for name in sorted(_names(function.__code__)):
        value: Any = function.__globals__.get(name)
        if hasattr(value, "stamp"):
            found.update(f"{name} {value.stamp}".encode())
        elif isinstance(value, np.ndarray):
            found.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
        elif isinstance(value, int | float | tuple):
            found.update(f"{name} {value!r}".encode())
        elif isinstance(value, type):
            found.update(f"{name} {getattr(value, '_fields', '')}".encode())
    return found.hexdigest()


def _names(code: CodeType) -> set[str]:
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)

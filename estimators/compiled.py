"""How the inner loops are compiled: numba, without fast-math, kept on disk from one start to the next.

Compiled code lies beside its source where that can be written, else in the user's cache; NUMBA_CACHE_DIR names
another place. Where nothing can be written, each start compiles anew.

numba is loaded with the first call, not with the modules: it takes a moment that not every command wants to wait.
A function that returns numbers alone and makes no arrays, nor calls what hands it any, borrows the arrays that it is
handed. An assignment of one array to a part of another makes one, too: numba buffers it, and asks for its runtime,
which such a function is compiled without.

It notices when a function's own file changes, not when one that it calls or a constant does: here the stamp of what
is kept covers all of them.
"""

from __future__ import annotations

import fcntl
import hashlib
import re
import sys
from collections.abc import Callable
from functools import cached_property, update_wrapper
from pathlib import Path
from types import CodeType, FunctionType, GenericAlias
from typing import Any, TypeVar, cast

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
_NUMBERS = {"None", "bool", "float", "int", "tuple"}
_MAKERS = {"append", "array", "argsort", "copy", "empty", "empty_like", "full", "ones", "zeros"}  # of arrays


def compiled(function: F) -> F:
    """Compile a function of numbers, arrays and named tuples of them; see numba's subset of Python.

    Divisions by zero give infinities, as numpy's do. Operations keep their order, so that results are the same to
    the last bit in every process on machines of one kind.
    """
    return cast(F, _Compiled(cast(FunctionType, function)))


def inlined(function: F) -> F:
    """Do as :func:`compiled`, and put the function's code where it is called.

    For what is handed arrays in an inner loop: handing them over takes longer than a short function does.
    """
    return cast(F, _Compiled(cast(FunctionType, function), forceinline=True))


def is_kept(function: Callable[..., Any]) -> bool:
    """Tell whether a compiled function was compiled by an earlier start."""
    index = _index_of(cast(Any, function).dispatcher)
    return index is not None and index.exists()


def _index_of(dispatcher: Any) -> Path | None:
    """Return the file that tells what of a function is kept, None where nothing can be."""
    file = getattr(dispatcher._cache, "_cache_file", None)
    return None if file is None else Path(file._index_path)


class _Compiled:
    """Called like the function; what it calls is compiled with it."""

    def __init__(self, function: FunctionType, forceinline: bool = False) -> None:
        self._function, self._forceinline = function, forceinline
        self._call: Callable[..., Any] = self._first_call
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def _first_call(self, *arguments: Any) -> Any:
        """Compile and call, or call what is kept. Processes that begin together do not all compile: one does."""
        self._call = dispatcher = self.dispatcher
        index = _index_of(dispatcher)
        if index is None or index.exists():
            return dispatcher(*arguments)
        index.parent.mkdir(parents=True, exist_ok=True)
        with index.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return dispatcher(*arguments)

    @cached_property
    def _used(self) -> dict[str, Any]:
        """The globals that the function uses, those in its annotations included."""
        every = self._function.__globals__
        names = _names(self._function.__code__).union(*map(_words, self._function.__annotations__.values()))
        return {name: every[name] for name in sorted(names) if name in every}

    @cached_property
    def stamp(self) -> str:
        """A hash of the function, of what it calls, and of the constants it uses."""
        found = hashlib.sha256(_code_bytes(self._function.__code__) + bytes([self._forceinline, self.borrows]))
        for name, value in self._used.items():
            if isinstance(value, _Compiled):
                found.update(f"{name} {value.stamp}".encode())
            elif isinstance(value, np.ndarray):
                found.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
            elif isinstance(value, int | float | tuple):
                found.update(f"{name} {value!r}".encode())
            elif isinstance(value, type):
                found.update(_layout(value).encode())
        return found.hexdigest()

    @cached_property
    def borrows(self) -> bool:
        """Whether the function makes no arrays, nor is handed any back, nor returns any.

        Then nobody counts on its way who refers to them: that took a quarter of a study's time.
        """
        used = self._used.values()
        makes = not _MAKERS.isdisjoint(_names(self._function.__code__))
        handed = any(isinstance(value, _Compiled) and not value.returns_numbers for value in used)
        return self.returns_numbers and not makes and not handed

    @cached_property
    def returns_numbers(self) -> bool:
        """Whether numbers, or tuples of them, are all that the function returns."""
        words = _words(self._function.__annotations__.get("return", "untold"))
        return all(_is_number(word, self._function.__globals__) for word in words)

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's own, which compiles for the arguments of a call."""
        import numba  # noqa: PLC0415  # see above

        from sidelong.estimators.kept_code import KeptCode  # noqa: PLC0415

        function = self._function
        known = dict(function.__globals__)
        linked = FunctionType(function.__code__, known, function.__name__)
        linked.__module__, linked.__qualname__ = function.__module__, function.__qualname__

        def link() -> None:
            """Put what numba can compile in the place of what the function calls."""
            for name, value in self._used.items():
                if isinstance(value, _Compiled):
                    known[name] = value.dispatcher

        options: dict[str, Any] = {"error_model": "numpy", "forceinline": self._forceinline, "_nrt": not self.borrows}
        dispatcher: Any = numba.njit(**options)(linked)
        try:
            dispatcher._cache = KeptCode(linked, self.stamp, link)
        except RuntimeError:  # there is no place to keep it
            link()
        return dispatcher


def _layout(kind: type) -> str:
    """Return the fields of a named tuple, those of its parts included."""
    parts = []
    for field, annotation in getattr(kind, "__annotations__", {}).items():
        words = _words(annotation)
        known = vars(sys.modules[kind.__module__])
        parts += [field, *words, *(_layout(known[word]) for word in words if isinstance(known.get(word), type))]
    return f"{kind.__name__} {parts}"


def _is_number(word: str, known: dict[str, Any]) -> bool:
    """Tell whether a word of an annotation stands for a number, or a named tuple of numbers alone."""
    if word in _NUMBERS:
        return True
    kind: Any = known.get(word)
    if isinstance(kind, GenericAlias):
        return all(part in _NUMBERS for part in _words(kind))
    fields = kind.__annotations__.values() if isinstance(kind, type) and hasattr(kind, "_fields") else ()
    inner = vars(sys.modules[kind.__module__]) if fields else {}
    return bool(fields) and all(_is_number(part, inner) for field in fields for part in _words(field))


def _words(annotation: object) -> list[str]:
    return re.findall(r"\w+", str(getattr(annotation, "__forward_arg__", annotation)))


def _names(code: CodeType) -> set[str]:
    return set(code.co_names).union(*map(_names, _inner(code)))


def _inner(code: CodeType) -> list[CodeType]:
    return [constant for constant in code.co_consts if isinstance(constant, CodeType)]


def _code_bytes(code: CodeType) -> bytes:
    plain = [constant for constant in code.co_consts if not isinstance(constant, CodeType)]
    return (
        code.co_code
        + repr((plain, code.co_names, code.co_varnames)).encode()
        + b"".join(map(_code_bytes, _inner(code)))
    )

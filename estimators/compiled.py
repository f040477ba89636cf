"""Compile the inner loops with numba and cache the machine code, one folder for each version of the code.

numba notices a change of a function's own file, but not of a function or constant it uses from another file. The name
of the folder therefore contains a digest of all kernels and of the modules that they import.

The folder is below ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache (``XDG_CACHE_HOME`` or ``~/.cache``).
If it cannot be written, a folder for this user below the system's temporary folder is used; where another user made
that one, a new folder for each process.

Source: <https://numba.readthedocs.io/en/stable/developer/caching.html>; docs/decisions/0005-compiled-kernels.md.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
_ROOT = Path(__file__).resolve().parents[1]
_FOLDERS = ("estimators", "mission", "app/analysis", "app/simulation", "app/study")
_UNUSED_S = 30 * 86_400.0


_IMPORTS = re.compile(r"^from sidelong\.([\w.]+) import \(?([\w, ]*)", re.MULTILINE)


def _kernel_digest() -> str:
    """Return twelve hexadecimal digits that change with any kernel, and any module that a kernel imports."""
    files = {file for folder in _FOLDERS for file in (_ROOT / folder).rglob("*_kernel.py")} | {Path(__file__)}
    digest, waiting = hashlib.sha256(), sorted(files)
    while waiting:
        file = waiting.pop()
        for module, names in _IMPORTS.findall(file.read_text()):
            path = _ROOT / module.replace(".", "/")
            found = {path.with_suffix(".py"), *(path / f"{name.strip()}.py" for name in names.split(","))}
            new = {one for one in found if one.is_file()} - files
            files |= new
            waiting += new
    for file in sorted(files):
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:12]


@cache
def code_digest() -> str:
    """Return twelve hexadecimal digits that change with any code of the program, which all flies in a study."""
    digest = hashlib.sha256()
    for folder in ("app", "estimators", "mission", "sitl"):
        for file in sorted((_ROOT / folder).rglob("*.py")):
            digest.update(file.relative_to(_ROOT).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()[:12]


def _chosen_folder() -> Path:
    """Return the first candidate that can be written; remove sibling folders that were not used for a month."""
    private = Path(tempfile.gettempdir()) / f"sidelong-{os.getuid()}"
    candidates = [private]
    with contextlib.suppress(RuntimeError):  # there is no home
        candidates.insert(0, Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sidelong")
    if os.environ.get("NUMBA_CACHE_DIR"):
        candidates.insert(0, Path(os.environ["NUMBA_CACHE_DIR"]))
    name = f"kernels-{_kernel_digest()}"
    for base in candidates:
        folder = base / name
        try:
            base.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            os.utime(folder)  # used now
        except OSError:
            continue
        # Code is loaded from here. Other users can create folders below the system's temporary folder: there, both
        # the folder and its base, whose owner could exchange it, must be our own.
        owners = {one.stat().st_uid for one in ((base, folder) if base == private else (folder,))}
        if os.access(folder, os.W_OK) and owners == {os.getuid()}:
            _remove_unused(base, folder.stat().st_mtime - _UNUSED_S)
            return folder
    folder = Path(tempfile.mkdtemp(prefix="sidelong-")) / name  # of this process alone
    folder.mkdir()
    return folder


def _remove_unused(base: Path, before_s: float) -> None:
    for folder in base.glob("kernels-*"):
        with contextlib.suppress(OSError):
            if folder.stat().st_mtime < before_s:
                shutil.rmtree(folder)


FOLDER = _chosen_folder()
"""Where this version's machine code is cached."""


@contextlib.contextmanager
def _hidden(package: str) -> Iterator[None]:
    """Let imports of a package fail, unless it is loaded already."""
    if package in sys.modules:
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[package]


# Where scipy is installed, numba would load its linear algebra: 15 MB that no kernel uses.
with _hidden("scipy"):
    import numba
    import numba.np.arraymath
    from llvmlite.binding import parse_bitcode  # type: ignore[import-untyped]
    from numba.core.codegen import CPUCodeLibrary


def _parse_when_linked(library: Any = CPUCodeLibrary) -> None:
    """Keep the LLVM module of cached code as bitcode until another kernel is linked with it.

    Parsed, the modules of a flight take 30 MB, and only the compiler needs them.
    """
    load, module_of = library._unserialize.__func__, library._get_module_for_linking

    def loaded(cls: Any, codegen: Any, state: Any) -> Any:
        made = load(cls, codegen, state)
        if state[1] == "object":
            made._bitcode, made._shared_module = state[2][1], None
        return made

    def module_for_linking(self: Any) -> Any:
        if self._shared_module is None and hasattr(self, "_bitcode"):
            self._shared_module = parse_bitcode(self._bitcode)
        return module_of(self)

    library._unserialize, library._get_module_for_linking = classmethod(loaded), module_for_linking


_parse_when_linked()
numba.config.CACHE_DIR = str(FOLDER)  # type: ignore[attr-defined]

KERNELS: list[Any] = []
"""Every compiled function, as numba's dispatcher."""


def _dispatcher(function: Any, **options: Any) -> Any:
    # No kernel is called from C: to compile such an entry takes a tenth of the time.
    options["no_cfunc_wrapper"] = True
    made: Any = numba.njit(cache=True, error_model="numpy", **options)(function)
    KERNELS.append(made)
    return made


def compiled(function: F) -> F:
    """Compile a function of numbers, arrays and named tuples of them; see numba's subset of Python.

    Divisions by zero give infinities, as numpy's do. Operations keep their order (no fast-math), so that results are
    the same to the last bit in every process on machines of one kind.
    """
    return cast(F, _dispatcher(function))


def inlined(function: F) -> F:
    """Compile as :func:`compiled` does, and put the function's code into its callers.

    For a short function in an inner loop that takes arrays: passing them costs more than the function itself.
    """
    return cast(F, _dispatcher(function, forceinline=True))


def inner(function: F) -> F:
    """Compile as :func:`compiled` does, for other kernels alone: a call from Python raises TypeError.

    To unpack the named tuples of a call from Python takes up to half of the time of its compilation.
    """
    return cast(F, _without_entry(_dispatcher(function, no_cpython_wrapper=True)))


def inner_inlined(function: F) -> F:
    """Compile as :func:`inner` does, and put the function's code into its callers."""
    return cast(F, _without_entry(_dispatcher(function, no_cpython_wrapper=True, forceinline=True)))


def _without_entry(dispatcher: Any) -> Any:
    """Let a dispatcher refuse calls from Python: numba's own would call at address zero."""
    kind: Any = type(dispatcher)
    dispatcher.__class__ = _refusing(kind)
    return dispatcher


@cache
def _refusing(kind: type) -> type:
    def refuse(self: Any, *_arguments: object) -> None:
        raise TypeError(f"{self.__name__} has no entry from Python: only other kernels call it")

    return type(kind.__name__, (kind,), {"__call__": refuse})


Record: TypeAlias = Any
"""A record of a :func:`record_type`: type checkers do not know its fields."""


def record_type(**fields: Any) -> np.dtype[Any]:
    """Return the type of a record whose named fields, (type, shape) for an array, compiled functions use."""
    of = [(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind in fields.items()]
    return np.dtype((np.record, of), align=True)


def new_record(of: np.dtype[Any]) -> Any:
    """Return an array of one record of a type, all zero.

    Named tuples hold the array: a call from Python takes 2.7 us more for a record, and no kernel can return one.
    """
    return np.zeros(1, of)


def is_cached(function: Callable[..., Any]) -> bool:
    """Return whether an earlier start has compiled a function and cached its machine code."""
    dispatcher = cast(Any, function)
    index = f"*.{dispatcher.py_func.__name__}-*.nbi"
    return any(Path(dispatcher.stats.cache_path).glob(index))

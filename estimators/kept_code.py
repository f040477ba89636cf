"""How numba finds compiled code of an earlier start again, sooner than by its own ways.

numba makes ready to compile before it looks for what is kept, and loads scipy for it: half a second, for nothing
where all is kept. Here that waits until there is something to compile, which makes itself ready; what kept code
stands on, the counting of references, is set up with the first. Beside a function's machine code lies the code that
others inline it from, which numba reads as well: here only who compiles does.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any

from llvmlite import binding
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime.nrt import rtsys


class _Library(JITCodeLibrary):
    """numba's, which reads what a kept function is inlined from when a caller of it is compiled, not before."""

    _inlined_from: bytes | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, _, (machine_code, inlined_from) = state
        library = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        library._inlined_from = inlined_from
        return library

    def get_pointer_to_function(self, name: str) -> Any:
        if self._inlined_from is None:
            return super().get_pointer_to_function(name)  # type: ignore[no-untyped-call]
        return self._codegen._engine.get_function_address(name)

    def _get_module_for_linking(self) -> Any:
        if self._inlined_from is not None and self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._inlined_from)
        return super()._get_module_for_linking()  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def _staying() -> Iterator[None]:
    """Search nothing for garbage while what stays is read: that took a third of the time."""
    searching = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searching:
            gc.enable()


class KeptCode(FunctionCache):
    """What is kept of one function, in files of its own for each stamp: numba reads even what is out of date.

    on_missing: called before the function is compiled. Raises RuntimeError where nothing can be kept.
    """

    def __init__(self, function: FunctionType, stamp: str, on_missing: Callable[[], None]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        name = f"{self._impl.filename_base}-{stamp[:16]}"
        self._cache_file = IndexDataCacheFile(self.cache_path, name, stamp)  # type: ignore[no-untyped-call]
        self._on_missing = on_missing

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept for these argument types, None where nothing is."""
        rtsys.initialize(target_context)
        target_context.codegen()._library_class = _Library
        with self._guard_against_spurious_io_errors(), _staying():
            kept = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if kept is None:
            self._on_missing()
        return kept

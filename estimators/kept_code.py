"""How numba finds compiled code of an earlier start again, sooner than by its own ways.

numba makes ready to compile before it looks for what is kept, and loads scipy for it: half a second, for nothing
where all is kept. Here that waits until there is something to compile, which makes itself ready; what kept code
stands on, the counting of references, is set up with the first.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime.nrt import rtsys


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
        with self._guard_against_spurious_io_errors():
            kept = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if kept is None:
            self._on_missing()
        return kept

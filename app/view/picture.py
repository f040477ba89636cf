"""The latest picture of a camera in a file, from which the page's server answers: a slow browser delays nothing."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

_EVERY_S = 0.2


class PictureFile:
    """A line of JSON with what is drawn on a picture, and the picture as JPEG, until ``close``."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="sidelong-"))
        self.file = self._folder / "picture"
        self._next_s = 0.0

    def put(self, picture: Callable[[], bytes]) -> None:
        """Replace the picture, at most five times a second. Raises OSError."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _EVERY_S
            whole = self.file.with_suffix(".new")
            whole.write_bytes(picture())
            whole.replace(self.file)

    def close(self) -> None:
        """Remove the file."""
        shutil.rmtree(self._folder, ignore_errors=True)

"""MAVSDK's own log, kept off the terminal.

It repeats texts of the vehicle byte by byte. The library's Python subscription decodes them first, as UTF-8, and
where that fails MAVSDK prints the bytes itself, escape sequences and all: so this subscribes beneath it, unseen.
"""

from __future__ import annotations

import ctypes

import mavsdk.logging


@mavsdk.logging.LogCallback  # type: ignore[untyped-decorator]  # MAVSDK has no types; the module keeps it alive
def _drop(_level: int, _message: bytes, _file: bytes, _line: int, _context: ctypes.c_void_p) -> bool:
    return True


def silence() -> None:
    """Drop what MAVSDK logs, from now on."""
    mavsdk.logging._cmavsdk_lib.mavsdk_log_subscribe(_drop, None)

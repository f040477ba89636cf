"""Files: texts within bounds, with errors of one sentence, written whole or not at all; long ones mapped."""

from __future__ import annotations

import codecs
import contextlib
import mmap
import os
import re
import shutil
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sidelong.app.errors import InputError

_CONFIG_MAX_BYTES = 256 << 10
_STRING_OR_COMMENT = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)
_AT_LINE = re.compile(r"at line (\d+)")
_TWICE = re.compile(r"Cannot declare \('([\w', ]+?)',?\) twice")
_DECIMAL_COMMA = re.compile(r"=\s*([+-]?\d+),(\d+)\s*(?:#.*)?$")
# The time that tomllib takes for a dotted key grows with the cube of its parts.
_LONG_KEY = re.compile(r"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){16}")


def read_text(path: Path, max_bytes: int, remedy: str) -> str:
    """Return a UTF-8 file's text. Raises InputError, which ends in ``remedy``, for what is none or too long."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no file; {remedy}.")
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot be read ({reason}); {remedy}.") from error
    if len(data) > max_bytes:
        raise InputError(f"{path}: is longer than {max_bytes >> 10} KiB; {remedy}.")
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: is text in UTF-16; save it as UTF-8 (in an editor: Save as, encoding UTF-8).")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text in UTF-8 (byte {error.start}); {remedy}.") from error


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the name to write to; it becomes ``path`` only once it is whole.

    If the body fails, as on a full disk, a file that was there stays and a new one does not appear. Pipes and devices
    are written directly.
    """
    whole = path.is_file() or not path.exists()
    path = path.resolve() if whole else path  # a symbolic link stays one
    partial = path.with_name(f"{path.name}.partial") if whole else path
    try:
        yield partial
        if whole:
            if path.exists():
                shutil.copymode(path, partial)
            partial.replace(path)
    finally:
        if whole:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all. Raises OSError."""
    with whole_file(path) as partial, partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        if partial != path:  # a pipe has no disk
            os.fsync(file.fileno())


def read_toml(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file. Raises InputError naming the file, what is wrong and the way out."""
    remedy = "give the path of a TOML file (sidelong init writes one)"
    text = read_text(path, _CONFIG_MAX_BYTES, remedy)
    if _LONG_KEY.search(_STRING_OR_COMMENT.sub("s", text)):
        raise InputError(f"{path}: is not valid TOML for this: a key has more than 16 parts; {remedy}.")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{path}: is not valid TOML for this: brackets are nested too deep; {remedy}.") from error
    except ValueError as error:
        raise InputError(f"{path}: is not valid TOML: {_cut(_explained(str(error), text))}") from error


def _explained(error: str, text: str) -> str:
    """Return a parser's error with the line it is about and, where it is clear, what to write instead."""
    twice = _TWICE.search(error)
    if twice is not None:
        error = f"the section [{twice[1]}] is there twice; join the two{error[twice.end() :]}"
    at = _AT_LINE.search(error)
    if at is None:
        return f"{error}; correct it."
    line = text.splitlines()[int(at[1]) - 1].strip()
    comma = _DECIMAL_COMMA.search(line)
    if comma is not None:
        return f"line {at[1]}, {line!r}: write decimals with a point: {comma[1]}.{comma[2]}."
    return f"{error}, {line!r}; correct it."


def _cut(text: str, longest: int = 160) -> str:
    return text if len(text) <= longest else text[: longest - 3] + "..."


Progress = Callable[[float], None]
"""Called with the completed fraction, 0 to 1."""


def unseen(_share: float) -> None:
    """Show no progress."""


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap | bytes]:
    """Map a file into memory; an empty one cannot be mapped and is b''. Raises OSError."""
    with path.open("rb") as opened:
        if path.stat().st_size == 0:
            yield b""
            return
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data

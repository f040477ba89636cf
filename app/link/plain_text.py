"""Texts of strangers (a vehicle, a file) as a terminal and a page may show them."""

from __future__ import annotations

from typing import Any


def plain(text: str) -> str:
    """Return the text on one line, with ``?`` for what cannot be shown, such as the escape of a sequence."""
    return _printable(text).strip()


def plain_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Return a message's fields with its texts made plain; their spaces stay, for a text may come in chunks."""
    return {name: _printable(value) if isinstance(value, str) else value for name, value in fields.items()}


def _printable(text: str) -> str:
    if text.isprintable():  # nearly all
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)

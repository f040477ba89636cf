"""Equations of the documentation, as MathML."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def math_fence(source: str, *_: Any, **__: Any) -> str:
    """Return a block of LaTeX, one equation a line, as MathML."""
    lines = [line for line in source.splitlines() if line.strip()]
    return "".join(f'<p class="equation">{convert(line, display="block")}</p>' for line in lines)

"""How a long read tells how far it is."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Is told the fraction that is done, 0 to 1."""

"""Kinds of problems that are imported late.

A table such as ``FAMILIES`` or ``JUDGES`` has entries by class. The package itself fills those of linear problems. What
has modes, kinks or levels registers its entries on import, which happens the first time that a table lacks an entry:
linear problems never import it, and no module outside of the folders ``hybrid`` names one inside.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock

_later: list[Callable[[], object]] = []
_lock = RLock()


def register_later(register: Callable[[], object]) -> None:
    """Take a function whose imports register further kinds; it is called once, when a table lacks an entry."""
    _later.append(register)


def register_all() -> None:
    """Import all kinds."""
    with _lock:
        while _later:
            _later[-1]()
            _later.pop()

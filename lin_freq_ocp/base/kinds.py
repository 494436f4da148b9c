"""Kinds of problems that register themselves.

Four tables have entries by the class of the dynamics: ``FORMS`` what a problem becomes, ``FAMILIES`` its methods,
``CERTIFIERS`` how a trajectory alone is certified, ``JUDGES`` its judge. The floors fill those of linear problems. The
folders ``hybrid`` register their own entries on import, at the latest when a table lacks an entry: no module of these
floors outside of a folder ``hybrid`` names one inside.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock

_later: list[Callable[[], object]] = []
_lock = RLock()


def register_later(register: Callable[[], object]) -> None:
    """Keep a function whose imports register further kinds, for one call when a table lacks an entry."""
    _later.append(register)


def register_all() -> None:
    """Import all kinds."""
    with _lock:
        while _later:
            _later[-1]()
            _later.pop()

"""The instances that the conformance suites run on, a list for each protocol.

A suite in tests/conformance runs each of its tests on all instances of its protocol, and fails if a class of the
package is not among them: a new class needs an instance here, and no further test of what the protocol says.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from importlib import import_module

from helpers.replacing import texts

ROOMS = ("problem", "transform", "methods", "solving", "uncertainty")  # these define the classes of the protocols


def classes_of(protocol: type) -> set[type]:
    """Return the classes of the package that implement a protocol and that a problem can have."""
    for module in texts():
        if module.split(".")[1:2] and module.split(".")[1] in ROOMS:
            import_module(module)
    return {kind for kind in derived(protocol) if not inspect.isabstract(kind) and not kind.__name__.startswith("_")}


def derived(protocol: type) -> Iterable[type]:
    """Yield the classes that derive from a class and that the package defines."""
    for kind in protocol.__subclasses__():
        if kind.__module__.startswith("lin_freq_ocp."):
            yield kind
        yield from derived(kind)

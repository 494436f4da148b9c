"""What dynamics of every kind call their signals and modes, and their sampling time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from lin_freq_ocp.arrays import brief, names, positive_number
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import first_few


def signal_labels(
    n: int, m: int, sampling_time: float | None, state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> dict[str, Any]:
    """Return the fields of ``Dynamics`` for n states and m controls, checked."""
    return {
        "state_dim": n,
        "control_dim": m,
        "sampling_time": None if sampling_time is None else positive_number("dynamics.sampling_time", sampling_time),
        "state_names": names("dynamics.state_names", state_names, n, "x"),
        "control_names": names("dynamics.control_names", control_names, m, "u"),
    }


def printable(field: str, name: Any) -> str:
    """Return a name, or "" for none."""
    if not isinstance(name, str) or not name.isprintable():
        raise ProblemError(field, brief(name), "a name of printable characters")
    return name


def mode_labels(given: Iterable[str]) -> tuple[str, ...]:
    """Return the names of modes, "mode i" where none is given."""
    found: dict[str, None] = {}
    for i, name in enumerate(given):
        printable(f"dynamics.modes[{i}].name", name)
        label = name or f"mode {i}"
        if label in found:
            raise ProblemError(f"dynamics.modes[{i}].name", f"{label!r} a second time", "a different name for each")
        found[label] = None
    return tuple(found)


def mode_facts(names: Sequence[str], kind: str) -> list[tuple[str, str]]:
    """Return how many modes there are, their names, and of what kind they are; nothing of a single mode."""
    if len(names) == 1:
        return []
    quoted = [f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}" for name in names]
    shown = first_few(quoted, 3 if max(map(len, quoted)) > 30 else 6)
    return [("modes", f"{len(names)}: {shown}; {kind}")]


def unique_names(given: Sequence[str]) -> list[str]:
    """Return names for modes that nobody named one by one: those that stand several times with a number.

    A mode without a name stays without, unless the default name of its place is another's.
    """
    labels = [name or f"mode {i}" for i, name in enumerate(given)]
    taken, unique = set(labels), list[str]()
    for name, label in zip(given, labels, strict=True):
        if labels.count(label) == 1:
            unique.append(name)
            continue
        numbered = (f"{label} ({count})" for count in range(1, 2 * len(labels) + 1))
        unique.append(next(one for one in numbered if one not in taken))
        taken.add(unique[-1])
    return unique

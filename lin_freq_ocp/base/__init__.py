"""What everything stands on: arrays, errors, statuses, text, polyhedra, whole files, memory, the clock."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_exports(
    package: str, names: Mapping[str, str], present: Callable[[object], object] = lambda value: value
) -> tuple[list[str], Callable[[str], object]]:
    """Return ``__all__`` and ``__getattr__`` of a package that imports its names when they are first used.

    ``names`` maps modules of the package to the names that others may import from them, separated by spaces; users get
    what ``present`` returns of each.
    """
    homes = {name: module for module, listed in names.items() for name in listed.split()}

    def import_name(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = present(getattr(import_module(f"{package}.{homes[name]}"), name))
        setattr(sys.modules[package], name, value)
        return value

    return list(homes), import_name


# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "activity": "BETWEEN_SECONDS FIRST_SECONDS TERMINAL_SECONDS TICK_SECONDS activity_line report_progress",
    "archives": "LARGE MOST_COMPRESSED MOST_ENTRIES",
    "arrays": "Array ComplexArray Indices assign first_largest split_signals stack_signals", "clock": "now use_clock",
    "kinds": "register_all",
    "cones": "Cone apply_scaling apply_scaling_twice compute_scaling product quotient spectral_values steepest",
    "interrupts": "interrupts_noted leave leave_silently let_commands_decide",
    "phrases": "NOTHING join_words number runs_in_words split_unit", "semidefinite": "RISES is_semidefinite",
    "polyhedra": "Cell PROJECTIONS SAME_FACET THICKNESS box_minimiser cell_of irredundant natural_sizes "
    "uncovered_point", "resources": "ALWAYS_THERE memory_limit",
})

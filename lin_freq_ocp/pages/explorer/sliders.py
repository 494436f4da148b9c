"""Which values of a linear problem can be moved, and the problem at other values.

A new kind is a ``Movable`` in the table ``MOVABLE``, and the group of its sliders in ``GROUPS``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError, ProblemError, suggestion
from lin_freq_ocp.pages.explorer.ends import ENDS
from lin_freq_ocp.pages.explorer.frequencies import FREQUENCIES
from lin_freq_ocp.pages.explorer.limits import BOUNDS, ROWS
from lin_freq_ocp.pages.explorer.slider import Movable, Slider, Values
from lin_freq_ocp.problem.ocp import OptimalControlProblem

HORIZON = "horizon"
HORIZON_NOTCHES = 60  # between half the problem's own horizon and its double, about

MOVABLE: tuple[Movable, ...] = (FREQUENCIES, BOUNDS, ROWS, ENDS)

# The groups of sliders in the order of the page, with their headings.
GROUPS = {
    "frequency": "Frequency",
    "bounds": "Control bounds",
    "rows": "Joint limits",
    "horizon": "Horizon",
    "state_bounds": "State bounds",
    "initial_state": "Initial state",
    "terminal_state": "Terminal state",
}
FOLDED = "state_bounds", "initial_state", "terminal_state"  # shown when they are asked for
KEPT = "bounds", *FOLDED  # what they change leaves what is set up once as it is

Rebuild = Callable[[int], OptimalControlProblem]  # the same problem over another horizon


def sliders_of(problem: OptimalControlProblem, rebuild: Rebuild | None) -> tuple[Slider, ...]:
    """Return the sliders of a problem, group by group."""
    found = [*_horizon(problem, rebuild), *(slider for kind in MOVABLE for slider in kind.sliders(problem))]
    return tuple(sorted(found, key=lambda slider: list(GROUPS).index(slider.group)))


def checked(sliders: tuple[Slider, ...], given: object) -> dict[str, float]:
    """Return the value of every slider, the problem's own where none is given; raise ProblemError if one is wrong."""
    if not isinstance(given, Mapping):
        raise ProblemError("values", brief(given), "an object with the values of sliders")
    known = {slider.key: slider for slider in sliders}
    for key, value in given.items():
        if key not in known:
            raise ProblemError(
                f"values.{key}", "no slider of that name", f"some of {', '.join(known)}", suggestion(key, known)
            )
        slider = known[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not slider.low <= value <= slider.high:
            expected = f"a number from {slider.low:.6g} to {slider.high:.6g} {slider.unit}".rstrip()
            raise ProblemError(f"values.{key}", brief(value), expected)
    return {key: float(given.get(key, slider.value)) for key, slider in known.items()}


def changed(sliders: tuple[Slider, ...], values: Values) -> dict[str, float]:
    """Return the values that are not the problem's own."""
    return {slider.key: values[slider.key] for slider in sliders if values[slider.key] != slider.value}


def problem_at(problem: OptimalControlProblem, rebuild: Rebuild | None, moved: Values) -> OptimalControlProblem:
    """Return the problem with these values."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)  # the page shows which bins are stopped
        if HORIZON in moved and rebuild is not None:
            problem = rebuild(int(moved[HORIZON]))
        fields = {field: value for kind in MOVABLE for field, value in kind.fields(problem, moved).items()}
        return replace(problem, **fields) if fields else problem


def _horizon(problem: OptimalControlProblem, rebuild: Rebuild | None) -> Iterator[Slider]:
    """Yield the horizon, if the problem can be built over others."""
    T = problem.horizon
    notch = max(1, T // HORIZON_NOTCHES)
    low, high = T - (T // 2 // notch) * notch, T + (T // notch) * notch
    if rebuild is not None and _can_be_built(rebuild, low) and _can_be_built(rebuild, high):
        yield Slider(HORIZON, "horizon", "horizon", "steps", low, high, notch, T, high)


def _can_be_built(rebuild: Rebuild, horizon: int) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)
        try:
            return rebuild(horizon).horizon == horizon
        except (LinFreqOCPError, TypeError, ValueError):  # no such parameter, or arrays over this horizon alone
            return False

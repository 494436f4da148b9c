"""Comparisons, and their pages: each is made once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from matplotlib.figure import Figure

from helpers.pages import double_integrator, parsed
from lin_freq_ocp import Box, OptimalControlProblem, compare, low_pass, stop_band
from lin_freq_ocp.library import pendulum, printer_move
from lin_freq_ocp.pages import Drawing, comparison_data, draw_figures, price_figure, render_page
from lin_freq_ocp.results import Comparison

CASES: dict[str, Callable[[], OptimalControlProblem]] = {
    "pendulum": pendulum,
    "not simulated": lambda: pendulum(horizon=100, sampling_time=0.1),
    "infeasible": lambda: pendulum(control_bound=4.5),
    "state band": lambda: double_integrator(
        sampling_time=0.01, state_spectrum=stop_band(bins=[5, 6], component=1), state_set=Box([None, -1], [None, 9])
    ),
    "two controls": lambda: double_integrator(
        controls=2,
        control_spectrum=low_pass(1.5, component=0),
        initial_state=(1.0, 0.5),
        terminal_state=Box(None, [0.5, 0.5]),
        name="<b>two</b> & $more$",
    ),
    "no band": lambda: double_integrator(),
}


@cache
def case(name: str) -> Comparison:
    filters = None if name == "pendulum" else ["brickwall", "zero_phase"]
    return compare(CASES[name](), filters=filters)


@cache
def moved() -> Comparison:
    """Return the comparison of a move with those of input shapers, which searches for many shortest moves."""
    return compare(printer_move())


@cache
def drawings(name: str):
    return tuple(draw_figures(case(name)))


def blanks():
    """Stand in for the drawings of a page of which only the words matter."""
    return tuple(Drawing(name, name, "", "<svg></svg>", Figure()) for name in ("comparison", "states"))


@cache
def page(name: str) -> str:
    return render_page(case(name), drawings(name))


@cache
def text(name: str) -> str:
    return parsed(page(name)).text


def price_axes(comparison: Comparison):
    assert comparison.prices is not None
    return price_figure(comparison_data(comparison), comparison.prices).axes

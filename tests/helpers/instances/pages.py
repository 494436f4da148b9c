"""Every page of the package, as it is saved, with names of signals that must be escaped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import lin_freq_ocp as lfo
from lin_freq_ocp.pages import Session, page, save_problem_page
from lin_freq_ocp.problem import problem_facts

NAMES = ["position <p> [m]", "speed & co [m/s]"], ["force $a$ [N]"]


def move(steps=20, sampling_time=0.1, **fields):
    """Return a move of a mass within two seconds."""
    h = sampling_time
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2], [h]], None, h, *NAMES)
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=[0.5, 0.0])
    given = {"control_set": lfo.Box(-1, 1), "name": "<b>move</b> & $stay$"} | fields
    return lfo.OptimalControlProblem(dynamics, steps, cost, **given)


def slow(cutoff):
    return {"control_spectrum": lfo.low_pass(cutoff_hz=cutoff)}


FROM_REST = {"initial_state": [0.0, 0.0], "terminal_state": [0.5, 0.0]}


def save_loop(folder: Path) -> Path:
    return lfo.RecedingHorizon(move(terminal_state=[0.0, 0.0])).run([0.2, 0.0], 3).save(folder)


def save_explorer(folder: Path) -> Path:
    """Save the live page without any solved point."""
    folder.mkdir()
    (folder / "index.html").write_text(page(Session(move(**FROM_REST, **slow(1.5))), []), encoding="utf-8")
    return folder / "index.html"


def save_problem(folder: Path) -> Path:
    problem, parameters = move(**FROM_REST), [("horizon = 20", "T")]
    return save_problem_page(problem.name, str(problem), parameters, problem_facts(problem), folder)


REPORTS: dict[str, Callable[[], lfo.results.Comparison]] = {
    "linear": lambda: lfo.compare(move(**FROM_REST, **slow(1.5)), ["brickwall"]),
    "infeasible": lambda: lfo.compare(move(**FROM_REST, **slow(0.3)), []),
    "levels": lambda: lfo.compare(
        move(8, 0.25, **FROM_REST, **slow(1.5), control_set=lfo.FiniteSet([-1, 0, 1])), ["brickwall"]
    ),
    "periodic": lambda: lfo.compare(move(terminal_state=lfo.Periodic(), **slow(1.5)), ["brickwall"]),
    "response": lambda: lfo.compare(lfo.library.wave_energy(horizon=40), ["brickwall"]),
    "vibration": lambda: lfo.compare(lfo.library.printer_move(14, distance=2e-3, vibration_bound=2.0)),
    "state band": lambda: lfo.compare(move(**FROM_REST, state_spectrum=lfo.stop_band(bins=[5, 6], component=1)), []),
}
PAGES: dict[str, tuple[str, Callable[[Path], Path]]] = {  # the template, and what saves the page
    **{name: ("page", lambda folder, make=make: make().save(folder)) for name, make in REPORTS.items()},
    "loop": ("tables", save_loop),
    "sweep": ("tables", lambda folder: lfo.sweep(move(**FROM_REST), {"horizon": [10, 20]}).save(folder)),
    "problem": ("tables", save_problem),
    "explorer": ("explore", save_explorer),
}

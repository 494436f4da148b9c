"""Modes that have the same map: the problem of two modes is then that of one, whose optimum is known."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive

A, B, ROW = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([1.0, -0.5])
SPECTRA = {
    "mask": {"control_spectrum": lfo.MagnitudeBound(0.6, bins=[1, 2, 3])},
    "mask on a state": {"state_spectrum": lfo.MagnitudeBound(2.5, bins=[1, 2, 3], component=0)},
    "notch": {"control_spectrum": lfo.stop_band(bins=[2])},
}
ENDS = {
    "start on the boundary": {"initial_state": [0.0, 0.0]},
    "target on the boundary": {"initial_state": [1.0, -1.0], "terminal_state": [0.0, 0.0]},
    "boundary on the way": {"initial_state": [1.0, 0.5]},
}
COSTS = {
    "quadratic": lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=[-0.5, 0.0]),
    "zero at rest": lfo.QuadraticCost(R=0.1, P=1.0),
    "L1": lfo.QuadraticCost(R=0.1) + lfo.costs.L1Cost(x=1.0, u=0.2),
}


def problem_of(dynamics: object, cost: str, ends: str, spectrum: str) -> lfo.OptimalControlProblem:
    return lfo.OptimalControlProblem(
        dynamics, 6, COSTS[cost], control_set=lfo.Box(-2.0, 2.0), **ENDS[ends], **SPECTRA[spectrum]
    )


def formulas_of_one_map(A: np.ndarray, B: np.ndarray, row: np.ndarray) -> lfo.PiecewiseSmoothDynamics:
    """Return A x + B u as formulas with maxima that cancel; they switch where row'(x, u) = 0."""

    def f(x, u):
        side = sum(row * np.concatenate([x, u]))
        first, *others = A @ x + B @ u
        return [first + lfo.maximum(0.3 * side, -0.2 * side) - lfo.maximum(0.3 * side, -0.2 * side), *others]

    return lfo.PiecewiseSmoothDynamics.from_formulas(f, *B.shape)


@expensive
@pytest.mark.parametrize(
    ("cost", "ends", "spectrum"),
    [
        ("zero at rest", "start on the boundary", "mask"),
        ("zero at rest", "start on the boundary", "mask on a state"),
        ("quadratic", "boundary on the way", "mask"),
        ("quadratic", "target on the boundary", "mask on a state"),
        ("L1", "boundary on the way", "notch"),
    ],
)
def test_equal_modes_have_the_optimum_of_one(cost, ends, spectrum):
    modes = [lfo.AffineMode(A, B, G=[sign * ROW], h=[0.0], name=f"side {sign}") for sign in (1, -1)]
    of_one = lfo.solve(problem_of(lfo.LinearDynamics(A, B), cost, ends, spectrum))
    of_modes = lfo.solve(problem_of(lfo.PiecewiseAffineDynamics(modes), cost, ends, spectrum), throw=False)
    dynamics = formulas_of_one_map(A, B, np.append(ROW, 0.0))
    of_formulas = lfo.solve(problem_of(dynamics, cost, ends, spectrum), global_bound=False, throw=False)
    assert (of_modes.status, of_formulas.status) == ("optimal", "locally_optimal")
    for result in (of_modes, of_formulas):
        assert result.certificate.pmp == "satisfied"
        assert result.cost == pytest.approx(of_one.cost, rel=1e-6, abs=1e-9)


@expensive
def test_a_sequence_that_needs_a_higher_price_of_violations_is_not_given_up():
    """With the first price, every sequence near that of the start leads to a point that violates the dynamics."""
    A, B = np.array([[-0.7]]), np.array([[1.06, 0.06]])
    of_formulas, of_one = (
        lfo.OptimalControlProblem(
            dynamics,
            8,
            lfo.QuadraticCost(R=0.5, P=1.4),
            control_set=lfo.Box(-2.0, 2.0),
            state_spectrum=lfo.MagnitudeBound(4.06, bins=[1, 2, 3, 4]),
            initial_state=[-2.33],
            terminal_state=[2.33],
        )
        for dynamics in (formulas_of_one_map(A, B, np.array([-0.41, -0.8, -0.28])), lfo.LinearDynamics(A, B))
    )
    result = lfo.solve(of_formulas, global_bound=False, throw=False)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(lfo.solve(of_one).cost, rel=1e-6)


@expensive
def test_a_start_that_no_step_improves_is_the_answer():
    def f(x, u):
        kink = abs(3.1 * x[0] + 2.6 * x[1] + 1.13 * u[0])
        return [
            -0.63 * x[0] + 0.56 * x[1] - 2.1 * u[0] + 0.15 * kink,
            -0.81 * x[0] - 0.37 * x[1] + 0.85 * u[0] - 0.1 * kink,
        ]

    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1),
        4,
        lfo.QuadraticCost(R=0.58, P=0.37),
        initial_state=[0.0, 0.0],
        control_spectrum=lfo.stop_band(bins=[2]),
    )
    result = lfo.solve(problem, global_bound=False, throw=False)
    assert (result.status, result.cost) == ("locally_optimal", 0.0)


def test_rounding_of_a_switching_boundary_is_no_size():
    """Along a trajectory on the boundary, the limits of regions were rounding, which limited the controls to 1e-19."""
    row = np.array([0.4, 0.33, 2.6])
    dynamics = formulas_of_one_map(np.array([[0.9]]), np.array([[0.3, 2.6]]), row)
    x, u = np.random.default_rng(0).standard_normal((2, 20))[:, :, None]
    u = np.hstack([u, -(row[0] * x + row[1] * u) / row[2]])
    assert not dynamics.affine_at(x, u).arrays(20).h.any()

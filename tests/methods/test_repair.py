"""The repair of a trajectory: every constraint holds, at the least change of the controls."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.methods import repair_trajectory
from lin_freq_ocp.methods.structured import break_times
from lin_freq_ocp.transform import sampled_masks

DYNAMICS = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)


def spoiled(problem, error=1e-9):
    """Return an optimal trajectory, and the same with errors in every value."""
    trajectory, rng = lfo.solve(problem).trajectory, np.random.default_rng(0)
    x, u = (part + error * rng.standard_normal(part.shape) for part in (trajectory.x, trajectory.u))
    return trajectory, lfo.Trajectory(x, u)


def holds(problem, trajectory):
    residual = trajectory.x[1:] - problem.linear.successors(trajectory.x, trajectory.u)
    assert np.abs(residual).max() <= 1e-14 * np.abs(trajectory.x).max()
    for signal, tube in ((trajectory.x, problem.state_tube), (trajectory.u, problem.control_tube)):
        assert tube.violation(signal).max() == 0.0
    for signal, stop in ((trajectory.u, problem.control_stop), (trajectory.x, problem.state_stop)):
        assert np.abs(np.fft.rfft(signal[: len(signal)], axis=0)[stop]).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("end", [None, [0.6, 0.0]])
@pytest.mark.parametrize("band", [None, "u", "x"])
def test_every_constraint_holds(band, end):
    problem = lfo.OptimalControlProblem(
        DYNAMICS,
        40,
        lfo.QuadraticCost(R=1.0, P=10.0, x_ref=[0.6, 0.0]),
        lfo.Box(-0.2, 0.2),
        None if end is None else lfo.Box([-1.0, -0.25], [1.0, 0.25]),
        [0.0, 0.0],
        end,
        control_spectrum=lfo.low_pass(cutoff_hz=2.0) if band == "u" else None,
        state_spectrum=lfo.stop_band(bins=range(17, 21), component=1) if band == "x" else None,
    )
    optimal, other = spoiled(problem)
    repaired = repair_trajectory(problem, other)
    holds(problem, repaired)
    assert np.abs(repaired.u - optimal.u).max() < 1e-5


@pytest.mark.parametrize("points", [None, [1.0, 1.0 + 1e-12, np.pi]])
def test_a_mask_at_its_limit_is_kept(points):
    """Atoms around a peak are rows that depend on each other."""
    w = 2 * np.pi * np.arange(5, 21) / 40 if points is None else np.array(points)
    mask = lfo.MagnitudeBound(0.15, band=lfo.low_pass(w[0] - 1e-9), every_frequency=points is not None)
    problem = lfo.OptimalControlProblem(
        DYNAMICS, 40, lfo.QuadraticCost(R=1.0), None, None, [0.0, 0.0], [0.6, 0.0], control_spectrum=mask
    )
    if points is not None:
        problem = sampled_masks(problem, {term.name: w for term in problem.terms}).problem
    optimal = lfo.solve(problem).trajectory
    other = lfo.Trajectory(optimal.x, (1 + 2e-7) * optimal.u)
    repaired = repair_trajectory(problem, other)
    holds(problem, repaired)
    before, after = (np.abs(np.exp(-1j * np.outer(w, np.arange(40))) @ one.u).max() for one in (other, repaired))
    assert before > 0.15 + 1e-10
    assert after <= 0.15 + 1e-13
    assert np.abs(repaired.u - optimal.u).max() < 1e-5


def test_outputs_of_a_frequency_response_follow_from_the_controls():
    problem = lfo.library.wave_energy(force=2000.0)
    optimal, other = spoiled(problem, 1e-6)
    repaired, response = repair_trajectory(problem, other), problem.form.response(problem.horizon)
    assert np.abs(repaired.x - response.states(repaired.u)).max() <= 1e-14 * np.abs(repaired.x).max()
    assert np.abs(repaired.u).max() <= 2000.0
    assert np.abs(np.fft.rfft(repaired.u, axis=0)[problem.control_stop]).max() < 1e-8
    assert np.abs(repaired.u - optimal.u).max() < 1e-4


def test_growth_over_the_horizon_is_cut_into_pieces():
    """The pendulum at 0.1 s grows by 3e46; a repair in one piece has no digit."""
    problem = lfo.library.pendulum(sampling_time=0.1)
    trajectory = lfo.solve(problem).trajectory
    repaired = repair_trajectory(problem, trajectory)
    holds(problem, repaired)
    assert problem.value(repaired.x, repaired.u) == pytest.approx(problem.value(trajectory.x, trajectory.u), rel=1e-9)


def test_breaks_are_where_the_states_grow_too_much():
    A = np.array([[2.0]])
    assert np.diff(break_times(A, 100, 1e3)).max() <= 10
    assert len(break_times(A, 100, 1e3)) >= 9
    np.testing.assert_array_equal(break_times(np.broadcast_to(A, (100, 1, 1)), 100, 1e3)[:2], [10, 20])
    assert not len(break_times(np.array([[0.9]]), 100, 1e3))


def test_there_is_none_where_no_control_reaches_the_end_or_another_constraint_fails():
    stuck = lfo.LinearDynamics(np.eye(2), [[1.0], [0.0]])
    problem = lfo.OptimalControlProblem(stuck, 5, lfo.QuadraticCost(R=1.0), None, None, [0.0, 1.0], [1.0, 1.001])
    assert repair_trajectory(problem, lfo.Trajectory(np.ones((6, 2)), np.zeros((5, 1)))) is None
    rows = lfo.StageRows(C=[[0.0, 0.0]], D=[[1.0]], e=[0.1])
    limited = lfo.OptimalControlProblem(
        DYNAMICS, 5, lfo.QuadraticCost(R=1.0), initial_state=[0, 0], stage_rows=rows, terminal_state=[0.01, 0.0]
    )
    assert repair_trajectory(limited, lfo.simulate(limited, [[0.0], [0.0], [0.5], [0.0], [0.0]])) is None

"""Faults: errors on their way between processes, solvers shared by threads, what nobody foresaw, failures to write."""

import pickle
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp import errors
from lin_freq_ocp.comparison.sweep_tasks import process_pool
from lin_freq_ocp.methods.spectral.violations import Violations

SHORT = partial(lfo.library.double_integrator, horizon=60, sampling_time=0.1, cutoff_hz=1.0)

ERRORS = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, lfo.LinFreqOCPError)]


# --- between processes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ERRORS)
def test_every_error_survives_pickling_with_all_it_holds(kind):
    arguments = ("cost.R", "-1", "a number above 0", "Square it.") if kind is lfo.ProblemError else ("what happened",)
    error = kind(*arguments)
    error.noted = "on the way"
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        again = pickle.loads(pickle.dumps(error, protocol))
        assert (type(again), str(again), vars(again)) == (kind, str(error), vars(error))


def test_the_result_of_an_error_survives_pickling():
    with pytest.raises(lfo.InfeasibleError) as caught:
        lfo.solve(SHORT(control_bound=1e-3))
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert again.result.status == "infeasible"
    assert again.result.conflict == caught.value.result.conflict
    np.testing.assert_array_equal(again.result.ray.eta, caught.value.result.ray.eta)


def test_a_bad_problem_kills_no_pool():
    """What a worker raises is unpickled by the pool's own thread, whose death takes the whole pool with it."""
    with process_pool(1) as pool:
        error = pool.submit(SHORT, control_bound=-1.0).exception(60)
        assert isinstance(error, lfo.ProblemError)
        assert error.field == "control_bound"
        rows = lfo.sweep(SHORT, {"control_bound": [-1.0, 1.0]}, pool).rows
    assert [row["status"] for row in rows] == ["error", "optimal"]
    assert rows[0]["message"] == str(error)


# --- between threads ------------------------------------------------------------------------------------------------


def test_threads_that_share_a_solver_get_the_answers_of_its_own(monkeypatch):
    """The pause lets another thread in between measuring a point and using what was measured."""
    problem = lfo.library.double_integrator(horizon=150, speed_bound=0.2, control_bound=0.6)
    ends = [[distance, 0.0] for distance in np.linspace(0.0, 0.46, 16)]
    alone = [lfo.SpectralSolver(problem).solve(terminal_state=end) for end in ends]
    honest = Violations.measure_values

    def pausing(*given):
        worst = honest(*given)
        time.sleep(0.001)
        return worst

    monkeypatch.setattr(Violations, "measure_values", pausing)
    solver = lfo.SpectralSolver(problem)
    with ThreadPoolExecutor(4) as threads:
        shared = list(threads.map(lambda end: solver.solve(terminal_state=end), ends))
    for one, other in zip(alone, shared, strict=True):
        assert one.status == other.status == "optimal"
        np.testing.assert_allclose(one.trajectory.u, other.trajectory.u, rtol=0, atol=1e-9)


def test_a_solver_can_be_sent_to_another_process():
    solver = lfo.SpectralSolver(SHORT())
    again = pickle.loads(pickle.dumps(solver))
    np.testing.assert_array_equal(again.solve().trajectory.u, solver.solve().trajectory.u)

"""Proofs of answers: the checker, which shares no code with the package, confirms the interval."""

import io
import sys

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.proof import lfo_check, proof_of


def confirmed(path):
    """Return the interval that the checker prints, and its exit status."""
    with path.open("rb") as file:
        return [float(one) for one in lfo_check.check(file, lambda text: None)]


def moved(**changed):
    """Return a small problem, a move of a unit mass, with other fields."""
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]])
    fields = {"control_set": lfo.Box(-3.0, 3.0), "initial_state": [0.0, 0.0], "terminal_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(dynamics, 24, **({"cost": lfo.QuadraticCost(R=1.0)} | fields | changed))


def masked(**bound):
    """Return a move with a mask on the control."""
    return moved(control_spectrum=lfo.spectrum.MagnitudeBound(band=lfo.low_pass(0.6), **bound))


def windowed(**bound):
    """Return a move with a mask on windows of the control."""
    mask = lfo.spectrum.MagnitudeBound(band=lfo.low_pass(1.2), **bound)
    return moved(control_spectrum=lfo.spectrum.Spectrogram(mask, length=12, hop=5))


def summed(penalty=None):
    """Return a move with an equation over all times."""
    waves = np.cos(np.arange(24))[:, None, None]
    return moved(control_spectrum=lfo.spectrum.LinearConstraint(waves, constant=[-0.5], penalty=penalty))


def periodic():
    """Return a periodic motion along a reference."""
    line = np.column_stack([np.sin(np.arange(25) * np.pi / 12), np.zeros(25)])
    bounds = {"initial_state": lfo.Box(-5.0, 5.0), "state_set": lfo.Box(-5.0, 5.0)}
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.1, x_ref=line)
    return moved(terminal_state=lfo.sets.Periodic(), cost=cost, **bounds)


def rows(penalty=None):
    """Return a move with joint rows on states and controls, and a norm in its cost."""
    joint = lfo.StageRows(C=[[0.0, 1.0]], D=[[0.1]], e=[0.6], penalty=penalty)
    return moved(cost=lfo.QuadraticCost(Q=0.01, R=1.0) + lfo.costs.L1Cost(u=0.2), stage_rows=joint, control_set=None)


def unstable():
    """Return a problem whose free motion grows by 1e14, with a free end."""
    dynamics = lfo.LinearDynamics([[1.5, 0.2], [0.0, 1.1]], [[0.0], [1.0]])
    return lfo.OptimalControlProblem(dynamics, 80, lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0), initial_state=[1.0, 0.0])


PROBLEMS = {
    "stop band": lfo.library.pendulum,
    "soft mask": lambda: masked(limit=0.2, penalty=1.0),
    "mask at bins": lambda: masked(limit=1.5),
    "mask at every frequency": lambda: masked(limit=2.5, every_frequency=True),
    "soft mask at every frequency": lambda: masked(limit=1.0, penalty=5.0, every_frequency=True),
    "unstable, without an end": unstable,
    "rows": rows,
    "soft rows": lambda: rows(penalty=0.5),
    "windows": lambda: windowed(limit=0.25),
    "soft windows": lambda: windowed(limit=0.2, penalty=0.3),
    "energy": lambda: moved(control_spectrum=lfo.spectrum.EnergyBound(0.5, bins=[0, 9, 10, 11, 12])),
    "equation over all times": summed,
    "soft equation": lambda: summed(penalty=0.3),
    "soft ball": lambda: moved(state_set=lfo.sets.Soft(lfo.sets.Ball(0.9), 0.6)),
    "output without bins": lambda: moved(
        output_spectrum=lfo.spectrum.OutputSpectrum([[1.0, 0.0]], [[0.1]], [lfo.spectrum.stop_band(bins=[0, 9, 12])])
    ),
    "periodic": periodic,
    "cones": lambda: lfo.library.quadcopter(horizon=20),
    "bounded slew rate": lambda: lfo.library.mri_gradient(),
}


@pytest.mark.parametrize("name", seeds(PROBLEMS))
def test_the_interval_is_narrow_and_the_file_proves_it(name, tmp_path):
    result = lfo.solve(PROBLEMS[name]())
    proven = result.enclosure
    assert result.status == "optimal"
    assert proven.lower <= proven.upper
    assert proven.width <= 1e-8 * abs(proven.upper)
    assert abs(result.cost - proven.upper) <= 1e-8 * abs(proven.upper)
    path = tmp_path / "run.proof"
    result.write_proof(path)
    assert confirmed(path) == pytest.approx([proven.lower, proven.upper], rel=1e-15)


def test_an_infeasible_problem_is_proven_so(tmp_path):
    result = lfo.solve(lfo.library.double_integrator(cutoff_hz=0.3), throw=False)
    assert result.enclosure.infeasible
    assert str(result.enclosure) == "no trajectory is feasible"
    path = tmp_path / "run.proof"
    result.write_proof(path)
    assert confirmed(path) == [np.inf, np.inf]


def test_another_number_in_the_problem_is_not_proven(tmp_path):
    proof, proven = proof_of(lfo.solve(lfo.library.double_integrator()))
    lines = list(proof.lines())
    place = next(i for i, text in enumerate(lines) if '"cost": "stage"' in text)
    lines[place] = lines[place].replace("0x1.0000000000000p+0", "0x1.0000100000000p+0")
    with pytest.raises(lfo_check.Failed):
        lfo_check.check(io.BytesIO("".join(lines).encode()), lambda text: None)
    assert proven.width < 1e-9 * proven.upper


def test_without_an_answer_there_is_nothing_to_prove():
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 3, lfo.QuadraticCost(r=[1.0]))
    result = lfo.solve(problem, throw=False)
    with pytest.raises(lfo.errors.SolveError, match="nothing to prove"):
        _ = result.enclosure


@expensive
def test_what_cannot_be_stated_is_refused_before_anything_is_written(tmp_path):
    result = lfo.solve(lfo.library.printer_move())
    with pytest.raises(lfo.errors.UnsupportedError, match="control_spectrum"):
        result.write_proof(tmp_path / "run.proof")
    assert list(tmp_path.iterdir()) == []


def test_without_the_extra_the_message_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(lfo.errors.MissingExtraError, match=r"'lin-freq-ocp\[proof\]', or .* -e '\.\[proof\]'"):
        _ = lfo.solve(lfo.library.double_integrator()).enclosure


@expensive
def test_a_long_proof_is_written_without_a_check_and_passes_it(tmp_path, monkeypatch):
    substitute(monkeypatch, "proof.LONGEST_CHECK", 100)
    substitute(monkeypatch, "proof.checked_enclosure", None)
    path = tmp_path / "run.proof"
    result = lfo.solve(lfo.library.double_integrator())
    result.write_proof(path)
    lower, upper = confirmed(path)
    assert lower <= upper <= lower * (1 + 1e-9)
    infeasible = lfo.solve(lfo.library.double_integrator(cutoff_hz=0.3), throw=False)
    infeasible.write_proof(path)
    assert confirmed(path) == [np.inf, np.inf]

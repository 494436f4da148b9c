"""Proofs of problems with a single step, with every kind of term that a proof states."""

import io

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.proof import lfo_check, proof_of
from lin_freq_ocp.spectrum import EnergyBound, LinearConstraint, OutputSpectrum, Spectrogram


def one_step(**changed):
    """Return a step of a mass that is pulled to 1, with other fields."""
    mass = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.2], [0.5]])
    cost = lfo.QuadraticCost(Q=0.5, R=0.1, P=2.0, x_ref=[1.0, 0.0])
    fields = {"dynamics": mass, "cost": cost, "control_set": lfo.Box(-3.0, 3.0), "initial_state": [0.0, 0.2]}
    return lfo.OptimalControlProblem(horizon=1, **(fields | changed))


def mask(limit=0.1, **options):
    return lfo.MagnitudeBound(limit, band=lfo.spectrum.high_pass(0.5), **options)


def rows(penalty=None):
    return lfo.StageRows([[0.0, 1.0]], [[1.0]], [0.25], penalty=penalty)


def hinge(x, u):
    return [x[0] + lfo.maximum(u[0], 0.5 * u[0]), x[1]]


VARYING = {"Q": np.ones((1, 2, 2)) + np.eye(2), "x_ref": [[1.0, 0.0], [0.5, 0.1]], "u_ref": [[0.2]], "q": [[0.1, 0.0]]}
PROBLEMS = {
    "quadratic": {},
    "data per time": {
        "cost": lfo.QuadraticCost(**VARYING, R=0.1, P=1.0),
        "dynamics": lfo.LinearDynamics(np.eye(2)[None], np.ones((1, 2, 1)), np.full((1, 2), 0.1)),
        "control_set": lfo.Box([[-0.1]], [[0.1]]),
    },
    "norms": {
        "cost": lfo.QuadraticCost(R=0.1) + lfo.costs.L1Cost(u=0.2, terminal=1.0) + lfo.costs.LInfCost(terminal=1)
    },
    "free start": {"initial_state": lfo.Box([-0.1, -0.2], [0.1, 0.2])},
    "fixed end": {"terminal_state": lfo.Box([0.12, None], [0.12, None])},
    "linked ends": {
        "initial_state": lfo.Box(-1, 1),
        "terminal_state": lfo.sets.LinkedEnds([[1.0, 0]], [[-1.0, 0]], [0]),
    },
    "rows": {"stage_rows": rows()},
    "soft rows": {"stage_rows": rows(0.3)},
    "ball": {"control_set": lfo.sets.Ball(0.1)},
    "soft ball": {"state_set": lfo.sets.Soft(lfo.sets.Ball(0.2), 0.3)},
    "cone": {"control_set": None, "state_set": lfo.sets.SecondOrderCone([[1.0, 0.0]], [0.0], [0.0, 1.0], 0.1)},
    "stop band": {"control_spectrum": lfo.stop_band(bins=[0])},
    "stop band of states": {"state_spectrum": lfo.stop_band(bins=[1], component=1), "initial_state": lfo.Box(-1, 1)},
    "mask": {"control_spectrum": mask()},
    "soft mask": {"control_spectrum": mask(penalty=0.2)},
    "fine mask": {"control_spectrum": mask(oversampling=4, between=True, penalty=0.1)},
    "mask at every frequency": {"control_spectrum": mask(every_frequency=True)},
    "energy": {"control_spectrum": EnergyBound(0.01, bins=[0])},
    "fine soft energy": {"control_spectrum": EnergyBound(0.01, bins=[0], oversampling=4, penalty=0.2)},
    "equation": {"control_spectrum": LinearConstraint([[[1.0]]], [-0.1])},
    "soft equation": {"control_spectrum": LinearConstraint([[[1.0]]], [-0.1], penalty=0.2)},
    "windows": {"control_spectrum": Spectrogram(mask(), length=1)},
    "output": {"output_spectrum": OutputSpectrum([[1.0, 0.0]], [[1.0]], mask(0.05))},
    "infeasible": {"terminal_state": [1.0, 9.0]},
    "modes": {"dynamics": lfo.PiecewiseAffineDynamics.from_formulas(hinge, 2, 1), "state_set": lfo.Box(-5, 5)},
}


@pytest.mark.filterwarnings("ignore::lin_freq_ocp.base.errors.BandWarning")  # a single control has a single bin
@pytest.mark.parametrize("name", seeds(PROBLEMS))
def test_the_checker_accepts_a_single_step(name):
    result = lfo.solve(one_step(**PROBLEMS[name]), throw=False)
    proof, _ = proof_of(result)
    interval = lfo_check.check(io.BytesIO("".join(proof.lines()).encode()), lambda text: None)
    lower, upper = (float(end) for end in interval)
    if name == "infeasible":
        assert result.enclosure.infeasible
        assert lower == np.inf
    else:
        assert result.status == "optimal"
        assert result.cost - 1e-7 <= lower <= upper <= result.cost + 1e-7

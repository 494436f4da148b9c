"""Path constraints in problem files, scripts and solution files."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.path_constraints import disc, mass, way_around
from helpers.seeds import expensive


def family(problem):
    at = lfo.Trajectory(np.linspace(-1, 1, 52).reshape(13, 4), np.linspace(-1, 1, 24).reshape(12, 2))
    (rows,) = problem.stage_rows
    return rows.name, rows.price, rows.convex, rows.limits().tolist(), rows.values(at.x, at.u).tolist()


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"h": lambda t, x, u: [disc(x, u) - 0.01 * t, abs(u[0]) - 3], "upper": [0.1, 2.0], "price": 3.0},
        {"h": ["exp(x_0)", "u_0**2"], "upper": [5.0, np.inf], "convex": True},
        {"h": "look_up(t, " + ", ".join(["1.0"] * 13) + ") * x_0", "upper": np.arange(13.0)[:, None]},
    ],
)
def test_it_survives_files(tmp_path, given):
    problem = mass(**given)
    lfo.write_problem(problem, tmp_path / "mass.toml")
    assert family(lfo.read_problem(tmp_path / "mass.toml")) == family(problem)


def test_named_formulas_are_read():
    tables = {"kind": "formula", "h": ["r - 4"], "let": {"r": "x_0**2 + x_1**2"}}
    rows = lfo.sets.PathConstraint(tables["h"], let=tables["let"])
    assert family(mass(rows.h, let=rows.let)) == family(mass("x_0**2 + x_1**2 - 4"))


@expensive
def test_a_solution_file_has_its_multipliers(tmp_path):
    result = way_around()
    result.save(tmp_path / "mass.npz")
    saved = lfo.load(tmp_path / "mass.npz")
    assert np.array_equal(saved.multipliers.stage["path"], result.multipliers.stage["path"])
    assert lfo.certify(result.problem, saved).pmp == "satisfied"


def test_a_function_without_text_is_refused_by_its_field(tmp_path):
    def jacobian(x, u):
        return np.array([[-2 * x[0], -2 * x[1], 0, 0, 0, 0]])

    function = lfo.DifferentiableFunction(lambda x, u: np.array([disc(x, u)]), jacobian, outputs=1)
    near = way_around().trajectory
    assert lfo.solve(mass(function), "nonsmooth", start=near).certificate.pmp == "satisfied"
    with pytest.raises(lfo.errors.ProblemError, match=r"stage_rows.*h\[0\]: got the function"):
        lfo.write_problem(mass(function), tmp_path / "mass.toml")

"""Saved solutions: their arrays, their certificates, and what is said of altered ones."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_json import CERTIFY, SOLVE, require, require_words
from helpers.command_line import parsed, run
from helpers.seeds import expensive

# --- solutions: saved, certified, tampered with ---------------------------------------------------------------------


MULTIPLIERS = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Solve the pendulum on the command line; return the path of the solution."""
    path = tmp_path_factory.mktemp("saved") / "run.npz"
    status, _, err = run("solve", "pendulum", "--json", "--save", str(path))
    assert (status, err) == (0, "")
    return path


def with_fields(saved, path, **changes):
    with np.load(saved, allow_pickle=False) as file:
        fields = dict(file) | changes
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return str(path)


def test_arrays_of_a_saved_solution(saved):
    with np.load(saved, allow_pickle=False) as file:
        shapes = {name: file[name].shape for name in file.files}
        assert {file[name].dtype.kind for name in ("x", "u", "eta", "mu", "nu")} == {"f"}
        assert {file[name].dtype.kind for name in ("rho_u", "rho_x")} == {"c"}
        assert (int(file["schema"]), float(file["eta_C"])) == (2, 1.0)
        summary = parsed(str(file["summary"]))
    assert shapes == {
        "x": (241, 4),
        "u": (240, 1),
        "eta_C": (),
        "eta": (240, 4),
        "mu": (241, 4),
        "nu": (240, 1),
        "rho_u": (121, 1),
        "rho_x": (121, 4),
        "schema": (),
        "summary": (),
    }
    require(summary, SOLVE)
    solution = lfo.load(saved)
    assert lfo.library.pendulum().cost.value(solution.trajectory.x, solution.trajectory.u) == summary["cost"]


@expensive
def test_a_saved_solution_is_certified(saved):
    status, out, err = run("certify", "pendulum", str(saved), "--json")
    summary = parsed(out)
    require(summary, CERTIFY)
    require_words(summary)
    assert (status, err) == (0, "")
    assert (summary["certificate"]["pmp"], summary["certificate"]["global"]) == ("satisfied", True)
    solution = lfo.load(saved)
    certificate = lfo.certify(lfo.library.pendulum(), solution.trajectory, solution.multipliers)
    assert (summary["cost"], summary["lower_bound"]) == (certificate.cost, certificate.lower_bound)
    status, out, err = run("certify", "pendulum", str(saved))
    assert (status, err) == (0, "")
    assert "maximum principle satisfied" in " ".join(out.split())


def test_a_trajectory_without_multipliers_is_certified(saved, tmp_path):
    path = with_fields(saved, tmp_path / "bare.npz", schema=None, summary=None, **dict.fromkeys(MULTIPLIERS))
    status, out, err = run("certify", "pendulum", path, "--json")
    assert (status, err) == (0, "")
    assert parsed(out)["certificate"]["pmp"] == "satisfied"


@pytest.mark.parametrize(
    ("field", "nudge", "fails"),
    [("u", 0.2, {"C-iii", "C-v", "C-vii"}), ("x", 0.01, {"C-iii"}), ("eta", 10.0, {"C-iii"}), ("eta_C", -1.0, {"C-v"})],
)
def test_a_tampered_solution_is_not_proven(saved, tmp_path, field, nudge, fails):
    with np.load(saved, allow_pickle=False) as file:
        value = file[field].copy()
    value[(100, 0) if value.ndim else ()] += nudge
    path = with_fields(saved, tmp_path / "tampered.npz", **{field: value})
    status, out, _ = run("certify", "pendulum", path, "--json")
    certificate = parsed(out)["certificate"]
    assert (status, certificate["pmp"], certificate["global"]) == (3, "violated", False)
    failed = [one for one in certificate["conditions"] if not one["passed"]]
    assert fails <= {one["label"] for one in failed}
    if field == "u":
        assert next(one for one in failed if one["name"] == "state equation")["time"] == 100
    status, out, _ = run("certify", "pendulum", path)
    assert (status, "fails" in out) == (3, True)


def test_a_solution_of_another_cost_is_not_proven(saved):
    status, out, _ = run("certify", "pendulum", str(saved), "--set", "cutoff=2.4", "--json")
    assert status == 3
    assert not next(one for one in parsed(out)["certificate"]["conditions"] if one["label"] == "C-vii")["passed"]


def test_a_point_without_proof_is_saved_and_stays_without(tmp_path):
    path = str(tmp_path / "limit.npz")
    assert run("solve", "pendulum", "--time-limit", "1e-9", "--save", path)[0] == 3
    assert run("certify", "pendulum", path)[0] == 3


@expensive
def test_without_a_trajectory_nothing_is_saved(tmp_path):
    path = tmp_path / "none.npz"
    assert run("solve", "pendulum", "--set", "horizon=60", "--set", "control_bound=1", "--save", str(path))[0] == 1
    assert not path.exists()


# --- as real processes ----------------------------------------------------------------------------------------------


def test_certify_says_whether_multipliers_are_unique_or_shows_a_descent(tmp_path):
    problem = ("double_integrator", "--set", "horizon=40", "--set", "sampling_time=0.1")
    status, _, _ = run("solve", *problem, "--save", str(tmp_path / "run.npz"))
    assert status == 0
    _, said, _ = run("certify", *problem, str(tmp_path / "run.npz"))
    assert "multipliers unique: the " in said
    narrower = (*problem, "--set", "cutoff_hz=2", "--csv", str(tmp_path / "narrower.csv"))  # feasible, and not optimal
    assert run("solve", *narrower)[0] == 0
    status, said, _ = run("certify", *problem, str(tmp_path / "narrower.csv"))
    assert "descent     no normal multipliers exist" in said
    assert status == 3

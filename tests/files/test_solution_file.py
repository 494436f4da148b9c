"""Solution files: what is written is read back, what is wrong is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lin_freq_ocp import Trajectory
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.files import load_solution, save_solution
from lin_freq_ocp.results import Multipliers


def some_solution(T: int = 6, n: int = 3, m: int = 2) -> tuple[Trajectory, Multipliers]:
    rng = np.random.default_rng(3)
    rho_u, rho_x = (rng.normal(size=(N // 2 + 1, k, 2)) @ [1, 1j] for N, k in ((T, m), (T + 1, n)))
    stage = {"rate [N]": rng.normal(size=(T, 2)), "a/b.npy": rng.normal(size=(T, 1))}
    multipliers = Multipliers(
        1.0, rng.normal(size=(T, n)), rng.normal(size=(T + 1, n)), rng.normal(size=(T, m)), rho_u, rho_x, stage
    )
    return Trajectory(rng.normal(size=(T + 1, n)), rng.normal(size=(T, m))), multipliers


def test_a_solution_survives_the_round_trip(tmp_path):
    trajectory, multipliers = some_solution()
    save_solution(tmp_path / "run", trajectory, multipliers, {"status": "optimal", "cost": 0.1, "bound": None})
    saved = load_solution(tmp_path / "run")
    assert saved.summary == {"status": "optimal", "cost": 0.1, "bound": None}
    assert saved.multipliers is not None
    for field in ("x", "u"):
        assert (getattr(saved.trajectory, field) == getattr(trajectory, field)).all()
    for field in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x"):
        assert np.all(getattr(saved.multipliers, field) == getattr(multipliers, field))
    assert saved.multipliers.stage.keys() == multipliers.stage.keys()
    for name, weights in multipliers.stage.items():
        assert (saved.multipliers.stage[name] == weights).all()
    with np.load(tmp_path / "run", allow_pickle=False) as file:
        fields = "x u eta_C eta mu nu rho_u rho_x schema summary".split()
        assert sorted(file.files) == sorted([*fields, "stage/rate [N]", "stage/a/b.npy"])
        assert int(file["schema"]) == 2
        assert json.loads(str(file["summary"]))["status"] == "optimal"


def test_a_file_of_the_first_version_is_read(tmp_path):
    trajectory, multipliers = some_solution()
    save_solution(tmp_path / "run.npz", trajectory, multipliers, {})
    with np.load(tmp_path / "run.npz", allow_pickle=False) as file:
        np.savez(tmp_path / "old.npz", **{**file, "schema": np.array(1)})
    assert load_solution(tmp_path / "old.npz").multipliers is not None


def test_a_trajectory_alone_is_a_solution_file(tmp_path):
    trajectory, _ = some_solution()
    save_solution(tmp_path / "own.npz", trajectory, None, {})
    np.savez(tmp_path / "foreign.npz", x=trajectory.x, u=trajectory.u, comment=np.array("from elsewhere"))
    for name in ("own.npz", "foreign.npz"):
        saved = load_solution(tmp_path / name)
        assert saved.multipliers is None
        assert saved.summary == {}
        assert (saved.trajectory.u == trajectory.u).all()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"x": None}, "run.npz: x: got nothing"),
        ({"u": None}, "run.npz: u: got nothing"),
        ({"u": np.zeros(6)}, "run.npz: u: got float64 of shape (6,)"),
        ({"x": np.zeros((6, 3))}, "run.npz: trajectory: got"),
        ({"x": np.full((7, 3), "a")}, "run.npz: x: got <U1"),
        ({"x": np.full((7, 3), np.nan)}, "run.npz: trajectory.x[0][0]: got nan"),
        ({"schema": np.array(3)}, "run.npz: schema: got"),
        ({"schema": np.array([1, 1])}, "run.npz: schema: got"),
        ({"mu": None}, "run.npz: mu: got nothing"),
        ({"eta_C": np.ones(2)}, "run.npz: eta_C: got float64 of shape (2,)"),
        ({"rho_u": np.zeros((2, 2))}, "run.npz: multipliers.rho_u: got shape (2, 2)"),
        ({"x": np.zeros((7, 2))}, "run.npz: multipliers: got eta (6, 3)"),
        ({"stage/rate [N]": np.zeros(6)}, "run.npz: stage/rate [N]: got float64 of shape (6,)"),
        ({"stage/rate [N]": np.zeros(5)}, "run.npz: stage/rate [N]: got float64 of shape (5,)"),
        ({"summary": np.array("{")}, "run.npz: summary: got"),
        ({"summary": np.array("3")}, "run.npz: summary: got 3"),
        ({"u": np.array([[{}]], dtype=object)}, "unreadable (Object arrays cannot be loaded"),
    ],
)
def test_a_bad_solution_file_is_refused(tmp_path, change, expected):
    trajectory, multipliers = some_solution()
    save_solution(tmp_path / "run.npz", trajectory, multipliers, {})
    with np.load(tmp_path / "run.npz") as file:
        fields = dict(file) | change
    np.savez(tmp_path / "run.npz", **{name: value for name, value in fields.items() if value is not None})
    with pytest.raises(ProblemError) as caught:
        load_solution(tmp_path / "run.npz")
    assert expected in str(caught.value)


def test_what_is_no_npz_is_refused(tmp_path):
    (tmp_path / "text.npz").write_text("x = 1")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "single.npy", np.eye(2))
    for name in ("text.npz", "empty.npz", "single.npy", "missing.npz", "."):
        with pytest.raises(ProblemError):
            load_solution(tmp_path / name)


def test_a_damaged_npz_is_refused_or_read(tmp_path):
    trajectory, multipliers = some_solution()
    save_solution(tmp_path / "run.npz", trajectory, multipliers, {"status": "optimal"})
    whole = (tmp_path / "run.npz").read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(300):
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=3):
            damaged[place] = rng.integers(256)
        (tmp_path / "run.npz").write_bytes(damaged[: rng.integers(len(whole) // 2, 2 * len(whole))])
        try:
            load_solution(tmp_path / "run.npz")
        except ProblemError:
            continue

"""Problem files of all sets, costs and frequency constraints: the problem read back is the same, to the last bit."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formulas import exact_text
from helpers.instances.statements import OF_A_USER, STATEMENTS
from helpers.random.mixed import FEATURES, problem_of, random_model
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.costs import L1Cost, LInfCost
from lin_freq_ocp.files import INLINE_LIMIT
from lin_freq_ocp.spectrum import EnergyBound, LinearConstraint, OutputSpectrum, Spectrogram, notch

T, N, M = 12, 3, 2
RNG = np.random.default_rng(5)

DYNAMICS = lfo.LinearDynamics(
    0.3 * RNG.standard_normal((N, N)),
    RNG.standard_normal((N, M)),
    sampling_time=0.1,
    state_names=["position [m]", "speed [m/s]", "angle [rad]"],
    control_names=["force [N]", "torque [N m]"],
)

F, CENTRE = RNG.standard_normal((4, N)), RNG.standard_normal(N)
POLYHEDRON = lfo.sets.Polyhedron(F, [1 / 3, np.inf, 2.0, 0.1])
BALL = lfo.sets.Ball(1 / 3, CENTRE)
ELLIPSOID = lfo.sets.Ellipsoid(RNG.standard_normal((2, N)), 0.7, CENTRE)
CONE = lfo.sets.SecondOrderCone(F, RNG.standard_normal(4), CENTRE, 0.9)
BOX = lfo.Box([-1 / 3, None, 0.0], [1.0, 2.0, None])

LOW = lfo.low_pass(cutoff_hz=2.0)
PER_BIN = RNG.uniform(0.1, 1.0, 4)

NAMES = {"state_names": DYNAMICS.state_names, "control_names": DYNAMICS.control_names, "sampling_time": 0.1}


def random_mode(*per_time: str, **region: Any) -> lfo.AffineMode:
    """Return a mode with random matrices, those named with one per time, and a region."""
    shapes = {"A": (N, N), "B": (N, M), "offset": (N,)}
    maps = {key: RNG.normal(size=(T, *shape) if key in per_time else shape) for key, shape in shapes.items()}
    return lfo.AffineMode(**maps, **region)


G, H, EDGE = RNG.normal(size=(1, N)), RNG.normal(size=(1, M)), RNG.normal(size=1)
PER_TIME = RNG.normal(size=(T, 1))
MODES: dict[str, list[lfo.AffineMode]] = {
    "one mode": [lfo.AffineMode(DYNAMICS.A, DYNAMICS.B)],
    "two modes": [random_mode(G=G, H=H, h=EDGE), random_mode(G=-G, H=-H, h=-EDGE)],
    "named modes": [random_mode(G=G, h=EDGE, name="below [m]"), random_mode(G=-G, h=-EDGE)],
    "regions in u": [random_mode(H=H, h=EDGE), random_mode(H=-H, h=-EDGE, name="“above”")],
    "maps per time": [random_mode("A", "offset", G=G, h=EDGE), random_mode("B", G=-G, h=-EDGE)],
    "limits per time": [random_mode(G=G, H=H, h=PER_TIME), random_mode(G=-G, H=-H, h=-PER_TIME)],
    "all per time": [
        random_mode("A", "B", "offset", G=np.tile(G, (T, 1, 1)), H=np.tile(H, (T, 1, 1)), h=PER_TIME),
        random_mode(G=np.tile(-G, (T, 1, 1)), H=-H, h=-PER_TIME),
    ],
    "rows without limits": [
        random_mode(G=np.vstack([G, F[0]]), h=[EDGE[0], np.inf]),
        random_mode(G=-G, H=np.zeros((1, M)), h=-EDGE),
    ],
    "rows without coefficients": [random_mode(G=np.zeros((2, N)), h=[np.inf, 1 / 3])],
    "unlimited per time": [random_mode(G=np.zeros((1, N)), h=np.full((T, 1), np.inf))],
}

FEATURES_ALONE: dict[str, dict[str, Any]] = {
    "polyhedron": {"state_set": POLYHEDRON},
    "ball": {"state_set": BALL},
    "ball around zero": {"control_set": lfo.sets.Ball(0.1)},
    "ellipsoid": {"state_set": ELLIPSOID},
    "cylinder around zero": {"terminal_state": lfo.sets.Ellipsoid([[1.0, 2.0, 0.0]])},
    "second-order cone": {"terminal_state": CONE},
    "intersection": {"state_set": BOX & POLYHEDRON & CONE},
    "intersection of intersections": {"state_set": lfo.sets.Intersection([BALL & BOX, lfo.Box(-9, 9) & ELLIPSOID])},
    "intersection with bounds per time": {"state_set": lfo.Box(-RNG.uniform(1, 2, size=(T + 1, N)), None) & BALL},
    "soft box": {"state_set": lfo.sets.Soft(BOX, 1 / 3)},
    "soft box of all components": {"control_set": lfo.sets.Soft(lfo.Box(-0.1, None), 2.0)},
    "periodic ends": {"terminal_state": lfo.Periodic()},
    "linked ends": {"terminal_state": lfo.sets.LinkedEnds(np.eye(2, N), -2 * np.eye(2, N), [0.5, 0.0])},
    "periodic ends in a box": {"terminal_state": lfo.Periodic() & lfo.Box(-1, None)},
    "soft polyhedron": {"initial_state": lfo.sets.Soft(POLYHEDRON, 0.1)},
    "soft ball": {"terminal_state": lfo.sets.Soft(BALL, 10.0)},
    "soft ellipsoid within a ball": {"state_set": lfo.sets.Soft(ELLIPSOID, 0.7) & lfo.sets.Ball(9.0)},
    "a ball per time": {"control_set": [lfo.sets.Ball(0.1 * (t + 1), [t / 3, 0.0]) for t in range(T)]},
    "the same ball at all times": {"control_set": [lfo.sets.Ball(0.1)] * T},
    "two polyhedra by turns": {"state_set": [POLYHEDRON, lfo.sets.Polyhedron(F, np.ones(4))] * (T // 2) + [POLYHEDRON]},
    "sets of all kinds by turns": {
        "state_set": [*(POLYHEDRON, BALL, ELLIPSOID, CONE, BOX & BALL, lfo.sets.Soft(BOX, 1.0), BOX), *[BALL, CONE] * 3]
    },
    "boxes per time": {"control_set": [lfo.Box(None, t) for t in range(T)]},
    "levels": {"control_set": lfo.FiniteSet([1.0, -1 / 3, 0.0], costs=[1.0, 1 / 3, 0.0])},
    "levels of each component": {"control_set": lfo.FiniteSet([[0, 1 / 3], [-1, 0, 1]], [[0.1, 0.2], [1, 0, 1 / 3]])},
    "levels with duty cycles": {"control_set": lfo.FiniteSet([0, 1, 2], [0.0, 2.0, 1.0], duty_cycles=True)},
    "L1 cost": {"cost": L1Cost(x=[0.1, 0.0, 1 / 3], u=0.7, terminal=2.0, x_ref=CENTRE)},
    "L1 cost per time": {
        "cost": lfo.QuadraticCost(R=1.0)
        + L1Cost(x=RNG.uniform(size=(T, N)), u_ref=RNG.normal(size=(T, M)), u=RNG.uniform(size=(T, M)))
    },
    "three norms": {
        "cost": LInfCost(x=1.0, x_ref=RNG.normal(size=(T + 1, N))) + L1Cost(u=0.1) + LInfCost(terminal=0.7)
    },
    "soft rows": {"stage_rows": lfo.StageRows(F, None, [0.1, 0.2, np.inf, 0.3], name="soft", penalty=1 / 3)},
    "soft rows beside hard ones": {
        "stage_rows": [
            lfo.StageRows(None, np.ones((T, 1, M)), RNG.uniform(size=(T, 1)), penalty=2.0),
            lfo.StageRows([[1.0, 0.0, 0.0]], [[0.0, 1.0]], [5.0], name="hard"),
        ]
    },
    "magnitude bound": {"control_spectrum": lfo.MagnitudeBound(1 / 3, band=LOW, component="force")},
    "magnitude bound on all components": {"state_spectrum": lfo.MagnitudeBound(0.0, bins=[1, -2, 12])},
    "magnitude bound in dB": {"control_spectrum": lfo.MagnitudeBound(limit_db=-7.0, reference=3.0, band=LOW)},
    "magnitude bound per bin in dB": {
        "control_spectrum": lfo.MagnitudeBound(limit_db=PER_BIN, reference=3.0, bins=[0, 1, 3, 6], component=1)
    },
    "magnitude bound per bin": {"control_spectrum": lfo.MagnitudeBound([0.1, np.inf, 1 / 3, 0.0], bins=[0, 1, 3, 6])},
    "windowed by name": {"state_spectrum": lfo.MagnitudeBound(0.2, band=LOW, window="hann")},
    "windowed by an array": {"state_spectrum": EnergyBound(0.2, band=LOW, window=RNG.uniform(size=T + 1))},
    "oversampled": {"control_spectrum": lfo.MagnitudeBound(0.2, band=notch(1.0, 0.7), oversampling=5)},
    "oversampled bins": {"control_spectrum": EnergyBound(0.2, bins=[2, 3], oversampling=4, window="blackman")},
    "soft bounds": {
        "control_spectrum": [
            lfo.MagnitudeBound(0.1, band=lfo.spectrum.high_pass(0.7), penalty=1 / 3),
            EnergyBound(1 / 7, band=lfo.spectrum.band_pass(0.6, 1.9), penalty=0.1, component="torque"),
            EnergyBound(0.0, band=lfo.low_pass(2.0, component="torque [N m]")),
        ]
    },
    "bands among bounds": {"control_spectrum": [EnergyBound(0.1, bins=[3]), LOW, lfo.stop_band(bins=[1])]},
    "linear constraint": {"control_spectrum": LinearConstraint(RNG.normal(size=(T, 2, M)), [0.1, 1 / 3])},
    "soft linear constraint": {"state_spectrum": LinearConstraint(RNG.normal(size=(T + 1, 1, N)), penalty=0.7)},
    "spectrogram": {
        "state_spectrum": Spectrogram(EnergyBound(0.2, bins=[2], window="hann"), 5, 2, RNG.normal(size=(3, N)))
    },
    "past and future": {"control_spectrum": Spectrogram(lfo.MagnitudeBound(0.3, band=LOW, component=1))},
    "outputs of states": {"output_spectrum": OutputSpectrum(F, constraints=EnergyBound(0.1, bins=[6]))},
    "outputs of controls": {"output_spectrum": OutputSpectrum(D=np.ones((1, M)), constraints=[LOW])},
    "outputs of both": {
        "output_spectrum": [
            OutputSpectrum(
                F[:2],
                RNG.normal(size=(2, M)),
                [lfo.MagnitudeBound(0.1, band=LOW, component="sway"), notch(1.0, 0.7, component="load [N]")],
                ["sway [m]", "load [N]"],
            ),
            OutputSpectrum(F, constraints=[lfo.MagnitudeBound(0.2, band=LOW, window="hann", penalty=1.0)]),
        ]
    },
}  # fmt: skip


def problem_with(**given: Any) -> lfo.OptimalControlProblem:
    return lfo.OptimalControlProblem(**{"dynamics": DYNAMICS, "horizon": T, "cost": lfo.QuadraticCost(R=1.0), **given})


def assert_same_arrays(one: Any, other: Any) -> None:
    """Compare two dataclasses of arrays and plain values, field by field."""
    assert type(one) is type(other)
    assert_same_fields(asdict(one), asdict(other))


def assert_same_fields(mine: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert mine.keys() == theirs.keys()
    for field, value in mine.items():
        if isinstance(value, dict):
            assert_same_fields(value, theirs[field])
            continue
        if field == "stages":  # of a sum over times
            for one, other in zip(value, theirs[field], strict=True):
                assert_same_fields(one, other)
            continue
        assert np.shape(value) == np.shape(theirs[field]), field
        assert np.array_equal(np.asarray(value), np.asarray(theirs[field])), field


def assert_same_dynamics(one: Any, other: Any) -> None:
    if not one.mode_names:
        known = [replace(dynamics, plant=None) if dynamics.plant else dynamics for dynamics in (one, other)]
        assert_same_arrays(*known)  # files state the sampled model
        return
    assert (one.sampling_time, one.state_names, one.control_names, one.mode_names) == (
        *(other.sampling_time, other.state_names, other.control_names),
        other.mode_names,
    )
    one, other = one.standard_form, other.standard_form
    assert [mode.name for mode in one.modes] == [mode.name for mode in other.modes]
    for mine, theirs in zip(one.modes, other.modes, strict=True):
        if isinstance(mine, lfo.dynamics.SmoothMode):
            for part in ("f", "region", "domain"):
                assert [exact_text(a) for a in getattr(mine, part)] == [exact_text(a) for a in getattr(theirs, part)]
            continue
        assert_same_arrays(mine.linear, theirs.linear)
        assert_same_arrays(mine.region, theirs.region)


def assert_same_problem(one: lfo.OptimalControlProblem, other: lfo.OptimalControlProblem) -> None:
    assert (one.name, one.horizon, one.sampling_time) == (other.name, other.horizon, other.sampling_time)
    assert_same_dynamics(one.dynamics, other.dynamics)
    assert_same_arrays(one.quadratic, other.quadratic)
    for tube in ("initial_box", "terminal_box", "state_tube", "control_tube"):
        for side in ("lower", "upper"):
            assert np.array_equal(getattr(getattr(one, tube), side), getattr(getattr(other, tube), side))
    assert np.array_equal(one.control_stop, other.control_stop)
    assert np.array_equal(one.state_stop, other.state_stop)
    assert [(term.name, term.kind, term.shape) for term in one.terms] == [
        (term.name, term.kind, term.shape) for term in other.terms
    ]
    for mine, theirs in zip(one.terms, other.terms, strict=True):
        assert_same_arrays(mine.map, theirs.map)
        assert_same_arrays(mine.penalty, theirs.penalty)
    rng = np.random.default_rng(9)
    for size in (0.1, 1.0, 10.0):
        x = size * rng.standard_normal((one.horizon + 1, one.state_dim))
        u = size * rng.standard_normal((one.horizon, one.control_dim))
        assert one.value(x, u) == other.value(x, u)
        for mine, theirs in zip(one.terms, other.terms, strict=True):
            assert np.array_equal(mine.map.values(x, u), theirs.map.values(x, u))
            assert np.array_equal(mine.violation(x, u), theirs.violation(x, u))
            assert np.array_equal(mine.cost(x, u), theirs.cost(x, u))


def round_trip(problem: lfo.OptimalControlProblem, folder: Path) -> dict[str, Any]:
    """Write, read, compare, and write again, which must give the same text; return the tables of the file."""
    lfo.write_problem(problem, folder / "problem.toml")
    again = lfo.read_problem(folder / "problem.toml")
    assert_same_problem(problem, again)
    (folder / "again").mkdir()
    lfo.write_problem(again, folder / "again" / "problem.toml")
    text = (folder / "problem.toml").read_text(encoding="utf-8")
    assert (folder / "again" / "problem.toml").read_text(encoding="utf-8") == text
    return tomllib.loads(text)


@pytest.mark.parametrize("feature", FEATURES_ALONE)
def test_every_feature_survives_the_round_trip(tmp_path, feature):
    problem = problem_with(**FEATURES_ALONE[feature])
    assert problem.terms or feature == "boxes per time"
    round_trip(problem, tmp_path)


NOT_WRITTEN = {*OF_A_USER, "response within discs"}  # a user's classes, and limits that lfo.robust makes


@pytest.mark.parametrize("name", seeds(name for name in STATEMENTS if name not in NOT_WRITTEN))
def test_every_class_of_the_package_survives_the_round_trip(tmp_path, name):
    round_trip(STATEMENTS[name](), tmp_path)


@pytest.mark.parametrize("name", MODES)
def test_modes_survive_the_round_trip(tmp_path, name):
    dynamics = lfo.PiecewiseAffineDynamics(MODES[name], **NAMES)
    tables = round_trip(problem_with(dynamics=dynamics, state_set=lfo.Box(-9, 9)), tmp_path)
    for mode, table in zip(dynamics.modes, tables["dynamics"]["modes"], strict=True):
        assert ("name" in table) == bool(mode.name)
        assert ("h" in table) == ("G" in table or "H" in table) == (name != "one mode")
        assert ("offset" in table) == (name != "one mode")


def test_large_arrays_of_modes_leave_the_text(tmp_path, monkeypatch):
    substitute(monkeypatch, "files.INLINE_LIMIT", 20)
    steps = 21
    edge = RNG.normal(size=(steps, 1))
    plant = np.array([[0.5]]), np.array([[1.0]])
    modes = [lfo.AffineMode(*plant, G=[[1.0]], h=edge), lfo.AffineMode(*plant, G=[[-1.0]], h=-edge, name="above")]
    problem = lfo.OptimalControlProblem(lfo.PiecewiseAffineDynamics(modes), steps, lfo.QuadraticCost(R=1.0))
    tables = round_trip(problem, tmp_path)
    assert tables["dynamics"]["modes"][1]["h"] == {"npz": "problem.problem.npz", "key": "dynamics.modes[1].h"}


@pytest.mark.parametrize("seed", seeds(range(24)))
def test_mixed_features_survive_the_round_trip(tmp_path, seed):
    round_trip(problem_of(random_model(seed)), tmp_path)


@expensive
def test_the_mixed_problems_have_every_feature():
    seen = {feature for seed in range(24) for feature in random_model(seed).features}
    assert seen == {feature.__name__.strip("_").replace("_", " ") for feature in FEATURES}


@pytest.mark.parametrize("name", seeds(lfo.library.PROBLEMS))
def test_the_library_survives_the_round_trip(tmp_path, name):
    round_trip(lfo.library.by_name(name)(), tmp_path)


def test_a_rate_limit_survives_the_round_trip(tmp_path):
    limited = lfo.rate_limited(problem_with(control_set=lfo.Box(-1, 1)), [0.1, None], previous=[0.0, 0.0])
    round_trip(limited, tmp_path)


def test_a_limit_in_decibels_is_written_as_stated(tmp_path):
    tables = round_trip(problem_with(**FEATURES_ALONE["magnitude bound in dB"]), tmp_path)
    stated = {"limit_db": -7.0, "reference": 3.0, "band": {"kind": "low_pass", "cutoff_hz": 2.0}}
    assert tables["control_spectrum"] == [{"kind": "magnitude_bound", **stated}]


def test_a_limit_in_decibels_is_read(tmp_path):
    lfo.write_problem(problem_with(), tmp_path / "cart.toml")
    bound = {"kind": "magnitude_bound", "limit_db": -7.0, "reference": 3.0, "band": {"kind": "low_pass", "cutoff": 1.0}}
    again = lfo.read_problem(tmp_path / "cart.toml", {"control_spectrum": bound})
    assert_same_problem(
        problem_with(control_spectrum=lfo.MagnitudeBound(limit_db=-7.0, reference=3.0, band=lfo.low_pass(1.0))), again
    )
    assert again.terms[0].penalty.radius[0] == 3.0 * 10 ** (-7.0 / 20)


def test_components_are_written_as_they_were_given(tmp_path):
    tables = round_trip(problem_with(**FEATURES_ALONE["soft bounds"]), tmp_path)
    by_name, in_band = tables["control_spectrum"][1:]
    assert by_name["component"] == "torque"
    assert (in_band["band"]["component"], "component" in in_band) == ("torque [N m]", False)
    tables = lfo.read_problem(tmp_path / "problem.toml").control_spectrum
    assert [one.component for one in tables] == [None, "torque", "torque [N m]"]


def test_soft_and_window_and_oversampling_are_written_only_where_given(tmp_path):
    tables = round_trip(problem_with(**FEATURES_ALONE["magnitude bound"]), tmp_path)
    assert set(tables["control_spectrum"][0]) == {"kind", "limit", "band", "component"}


def test_large_arrays_of_all_features_leave_the_text(tmp_path):
    steps = INLINE_LIMIT // M + 1
    problem = problem_with(
        horizon=steps,
        cost=lfo.QuadraticCost(R=1.0) + L1Cost(u=RNG.uniform(size=(steps, M))),
        control_set=lfo.Box(-RNG.uniform(1, 2, size=(steps, M)), None) & lfo.sets.Ball(9.0),
        state_set=lfo.sets.Polyhedron(RNG.normal(size=(INLINE_LIMIT, N)), np.full(INLINE_LIMIT, 9.0)),
        control_spectrum=[LinearConstraint(RNG.normal(size=(steps, 1, M)))],
        output_spectrum=OutputSpectrum(
            np.ones((1, N)), constraints=[EnergyBound(1.0, band=LOW), lfo.MagnitudeBound(1.0, band=LOW)]
        ),
        state_spectrum=lfo.MagnitudeBound(1.0, band=LOW, window="hann", component=0),
    )
    round_trip(problem, tmp_path)
    with np.load(tmp_path / "problem.problem.npz", allow_pickle=False) as beside:
        assert sorted(beside.files) == [
            "control_set.sets[0].lower",
            "control_set.sets[0].upper",
            "control_spectrum[0].coefficients",
            "cost.norms[0].u",
            "state_set.F",
        ]
    windowed = EnergyBound(1.0, band=LOW, window=RNG.uniform(size=2 * INLINE_LIMIT))
    long = problem_with(horizon=2 * INLINE_LIMIT, control_spectrum=[LOW, windowed])
    (tmp_path / "long").mkdir()
    tables = round_trip(long, tmp_path / "long")
    assert tables["control_spectrum"][1]["window"] == {
        "npz": "problem.problem.npz",
        "key": "control_spectrum[1].window",
    }


def test_a_problem_read_back_has_the_same_optimum(tmp_path):
    model = random_model(2)
    lfo.write_problem(problem_of(model), tmp_path / "problem.toml")
    one, other = lfo.solve(problem_of(model)), lfo.solve(lfo.read_problem(tmp_path / "problem.toml"))
    assert one.cost == other.cost
    assert np.array_equal(one.trajectory.x, other.trajectory.x)


class Diamond(lfo.sets.Ball):
    """A set of a user's own."""


class Huber(L1Cost):
    """A cost of a user's own."""


def test_what_no_file_can_hold_is_refused_in_words(tmp_path):
    with pytest.raises(lfo.errors.ProblemError, match=r"state_set: got .*expected a set that a problem file can hold"):
        lfo.write_problem(problem_with(state_set=Diamond(1.0)), tmp_path / "problem.toml")
    with pytest.raises(
        lfo.errors.ProblemError, match=r"cost.norms\[0\]: got .*expected a cost that a problem file can hold"
    ):
        lfo.write_problem(problem_with(cost=Huber(u=1.0)), tmp_path / "problem.toml")
    assert not (tmp_path / "problem.toml").exists()


def test_repeated_sets_are_one_constraint_however_they_are_given():
    """The same matrix at all times is not stacked, whether it is one object or many of equal values."""
    once = problem_with(control_set=lfo.sets.Ball(0.1))
    often = problem_with(control_set=[lfo.sets.Ball(0.1) for _ in range(T)])
    assert once.terms[0].map.D.shape == often.terms[0].map.D.shape == (M, M)
    moving = replace(once, control_set=[lfo.sets.Ball(0.1, [t, 0.0]) for t in range(T)])
    assert (moving.terms[0].map.D.shape, moving.terms[0].map.constant.shape) == ((M, M), (T, M))

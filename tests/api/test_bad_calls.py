"""What is wrong in a call from Python is refused with field, value and expectation."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import lin_freq_ocp as lfo


def problem(**changes):
    given = {
        "dynamics": lfo.LinearDynamics(
            [[1.0, 0.1], [0.0, 1.0]],
            [[0.005], [0.1]],
            sampling_time=0.1,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["force [N]"],
        ),
        "horizon": 8,
        "cost": lfo.QuadraticCost(R=1.0),
        "initial_state": [0.0, 0.0],
    }
    return lfo.OptimalControlProblem(**(given | changes))


def dynamics(**changes):
    return lfo.LinearDynamics(**({"A": np.eye(2), "B": np.ones((2, 1))} | changes))


BAD_CALLS = {
    "A not square": (lambda: dynamics(A=np.ones((2, 3))), "dynamics.A: got shape (2, 3)"),
    "A empty": (lambda: dynamics(A=np.empty((0, 0))), "dynamics.A: got shape (0, 0)"),
    "A complex": (lambda: dynamics(A=1j * np.eye(2)), "dynamics.A: got"),
    "A inf": (lambda: dynamics(A=[[1, np.inf], [0, 1]]), "dynamics.A[0][1]: got inf"),
    "B nan": (lambda: dynamics(B=[[1], [np.nan]]), "dynamics.B[1][0]: got nan"),
    "B a vector": (lambda: dynamics(B=[1, 2]), "dynamics.B: got shape (2,)"),
    "names repeated": (lambda: dynamics(state_names=["x", "x"]), "dynamics.state_names: got ['x', 'x']"),
    "names too few": (lambda: dynamics(control_names=[]), "dynamics.control_names: got []"),
    "sampling time inf": (lambda: dynamics(sampling_time=np.inf), "dynamics.sampling_time: got inf"),
    "A for other times": (lambda: problem(dynamics=dynamics(A=[np.eye(2)] * 7)), "dynamics.A: got 7 times"),
    "dynamics a matrix": (lambda: problem(dynamics=np.eye(2)), "dynamics: got array"),
    "horizon numpy float": (lambda: problem(horizon=np.float64(8)), "horizon: got"),
    "horizon numpy bool": (lambda: problem(horizon=np.True_), "horizon: got"),
    "horizon None": (lambda: problem(horizon=None), "horizon: got None"),
    "cost a number": (lambda: problem(cost=1.0), "cost: got 1.0"),
    "cost nan": (lambda: lfo.QuadraticCost(R=np.nan), "cost.R: got nan"),
    "S of wrong shape": (lambda: problem(cost=lfo.QuadraticCost(S=np.ones((1, 2)))), "cost.S: got shape (1, 2)"),
    "reference of wrong length": (
        lambda: problem(cost=lfo.QuadraticCost(Q=1.0, x_ref=np.ones((8, 2)))),
        "cost.x_ref: got shape (8, 2)",
    ),
    "Q a diagonal": (
        lambda: problem(cost=lfo.QuadraticCost(Q=[1.0, 2.0])),
        "cost.Q: got shape (2,); expected shape (2, 2), or (8, 2, 2) with one per time. State a diagonal matrix",
    ),
    "P per time": (lambda: problem(cost=lfo.QuadraticCost(P=[np.eye(2)] * 8)), "cost.P: got shape (8, 2, 2)"),
    "box upside down": (lambda: lfo.Box([0, 2], [1, 1]), "Box.lower[1]: got 2 above upper[1] = 1"),
    "box of two shapes": (lambda: lfo.Box([0, 0], [1, 1, 1]), "Box: got lower of shape (2,), upper of shape (3,)"),
    "box of text": (lambda: lfo.Box("a", "b"), "Box.lower: got 'a'"),
    "point with None": (lambda: lfo.sets.Point([None, 0.0]), "Point: got [None, 0.0]"),
    "set a pair": (lambda: problem(control_set=(-5, 5)), "control_set: got a sequence of 2"),
    "sets too few": (lambda: problem(state_set=[lfo.Box(-1, 1)] * 8), "state_set: got a sequence of 8"),
    "band a number": (lambda: problem(control_spectrum=20), "control_spectrum: got 20"),
    "band on an unknown state": (
        lambda: problem(state_spectrum=[lfo.low_pass(1.0, component="angle")]),
        "state_spectrum[0].component: got 'angle'",
    ),
    "band in hertz without a clock": (
        lambda: problem(dynamics=dynamics(), control_spectrum=lfo.low_pass(cutoff_hz=1)),
        "control_spectrum: got low_pass(0 .. 1 Hz); expected a sampling time",
    ),
    "cut-off twice": (lambda: lfo.low_pass(1.0, cutoff_hz=1.0), "low_pass.cutoff: got both of cutoff and cutoff_hz"),
    "cut-off in words": (lambda: lfo.low_pass(cutoff_hz="30 Hz"), "low_pass.cutoff_hz: got '30 Hz'"),
    "weather of another length": (
        lambda: problem(
            dynamics=lfo.LinearDynamics.from_continuous(
                np.zeros((2, 2)), [[0], [1]], 0.1, disturbance=[[1], [0]], d=[1] * 7
            )
        ),
        "dynamics.d: got 7 times; expected one for each of the 8 steps of the horizon",
    ),
    "cut-off nowhere": (lambda: lfo.spectrum.high_pass(), "high_pass.cutoff: got neither of cutoff and cutoff_hz"),
    "cut-off beyond Nyquist": (lambda: lfo.spectrum.high_pass(3.2), "high_pass.cutoff: got 3.2 rad/sample"),
    "edges exchanged": (lambda: lfo.spectrum.band_pass(2, 1), "band_pass: got lower 2 above upper 1"),
    "notch of no width": (lambda: lfo.spectrum.notch(1.0, 0.0), "notch.width: got 0"),
    "notch of negative width": (lambda: lfo.spectrum.notch(1.0, -1.0), "notch.width: got -1"),
    "no bins": (lambda: lfo.stop_band(bins=[]), "stop_band.bins: got []"),
    "bins by halves": (lambda: lfo.stop_band(bins=[0.5]), "stop_band.bins: got [0.5]"),
    "bin true": (lambda: lfo.stop_band(bins=[True]), "stop_band.bins: got [True]"),
    "bins out of range": (
        lambda: problem(control_spectrum=lfo.stop_band(bins=[9])),
        "control_spectrum.bins: got bin 9",
    ),
    "bins far out of range": (
        lambda: problem(state_spectrum=lfo.stop_band(bins=[-(10**30)])),
        "state_spectrum.bins: got bin -1000",
    ),
    "trajectory with time last": (lambda: lfo.Trajectory(np.ones((2, 9)), np.ones((2, 8))), "trajectory: got x (2, 9)"),
    "trajectory nan": (lambda: lfo.Trajectory([[np.nan]], np.empty((0, 1))), "trajectory.x[0][0]: got nan"),
    "control of another length": (lambda: lfo.certify(problem(), np.zeros((7, 1))), "u: got shape (7, 1)"),
    "control without a start": (
        lambda: lfo.simulate(problem(initial_state=None), np.zeros((8, 1))),
        "initial_state: got None",
    ),
    "start of another size": (
        lambda: lfo.simulate(problem(), np.zeros((8, 1)), [0.0]),
        "initial_state: got shape (1,)",
    ),
    "trajectory of another problem": (
        lambda: lfo.certify(problem(), lfo.Trajectory(np.ones((9, 3)), np.ones((8, 1)))),
        "trajectory: got x (9, 3), u (8, 1); expected x (9, 2), u (8, 1)",
    ),
    "no such filter": (lambda: lfo.compare(problem(), filters=["magic"]), "filters: got 'magic'"),
    "filters one word": (lambda: lfo.compare(problem(), filters="brickwall"), "filters: got"),
    "no such solution": (lambda: lfo.load("no/such/run.npz"), "no/such/run.npz: got no such file"),
    "no such problem": (lambda: lfo.library.by_name("pendulums"), "name: got 'pendulums'"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_bad_call(case):
    call, words = BAD_CALLS[case]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        call()
    assert words in str(caught.value)
    assert f"{caught.value.field}: got {caught.value.got}; expected {caught.value.expected}." in str(caught.value)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: lfo.solve(problem(), method="magic"), lfo.errors.UnsupportedError, "method: got 'magic'"),
        (lambda: lfo.solve(problem(), backend="magic"), lfo.errors.UnsupportedError, "backend: got 'magic'"),
        (lambda: lfo.solve(problem(), time_limit=-1.0), lfo.errors.UnsupportedError, "time_limit: got -1.0"),
        (
            lambda: problem(control_set=(-5, 5)),
            lfo.errors.ProblemError,
            "one per time. Bounds are lfo.Box(lower, upper)",
        ),
        (lambda: lfo.solve(problem(), time_limit="3"), lfo.errors.UnsupportedError, "time_limit: got '3'"),
        (lambda: lfo.solve(problem(), tolerance=np.nan), lfo.errors.UnsupportedError, "tolerance: got nan"),
        (lambda: lfo.solve(problem(cost=lfo.QuadraticCost(Q=-3.0))), lfo.errors.UnsupportedError, "eigenvalue -3"),
        (
            lambda: lfo.solve(problem(), backend="qpsolvers:nonesuch"),
            lfo.errors.UnsupportedError,
            "'qpsolvers:nonesuch'",
        ),
        (
            lambda: lfo.simulate(problem(dynamics=dynamics(A=1e200 * np.eye(2))), np.ones((8, 1))),
            lfo.errors.NumericalError,
            "overflows at t = 3",
        ),
    ],
)
def test_what_is_not_supported_says_so(call, error, words):
    with pytest.raises(error) as caught:
        call()
    assert words in str(caught.value)
    assert isinstance(caught.value, lfo.errors.LinFreqOCPError)


@pytest.mark.parametrize(
    "call",
    [lfo.solve, lfo.compare, lfo.explain, lambda text: lfo.certify(text, 1), lambda text: lfo.rate_limited(text, 1)],
)
def test_what_is_no_problem_is_refused(call):
    with pytest.raises(lfo.errors.ProblemError, match=r"problem: got 'cart\.toml'; expected an OptimalControlProblem"):
        call("cart.toml")


def test_an_unknown_keyword_of_solve_is_refused_with_the_right_one():
    problem = lfo.library.double_integrator()
    with pytest.raises(lfo.errors.ProblemError, match=r"solver: got 'OSQP'; .* backend= chooses the solver"):
        lfo.solve(problem, solver="OSQP")
    with pytest.raises(lfo.errors.ProblemError, match=r"timelimit: got 3; .* Did you mean 'time_limit'\?"):
        lfo.solve(problem, timelimit=3)


LOOP = lfo.RecedingHorizon(lfo.library.double_integrator())
MISSPELT = {
    "amplitud": (lambda: lfo.MagnitudeBound(amplitud=1), "amplitude"),
    "lowr": (lambda: lfo.Box(lowr=1), "lower"),
    "radus": (lambda: lfo.sets.Ball(radus=1), "radius"),
    "control_sets": (lambda: lfo.OptimalControlProblem(control_sets=1), "control_set"),
    "samplingtime": (lambda: lfo.LinearDynamics.from_continuous([[0]], [[1]], samplingtime=1), "sampling_time"),
    "filter": (lambda: lfo.compare(None, filter=[]), "filters"),
    "initial_state": (lambda: lfo.solve_many(None, initial_state=[0]), "initial_states"),
    "dely": (lambda: lfo.RecedingHorizon(None, dely=1), "delay"),
    "stag": (lambda: lfo.costs.SmoothCost(stag=1), "stage"),
    "horizn": (lambda: lfo.library.pendulum(horizn=300), "horizon"),
    "name": (lambda: lfo.maximum(1, 2, name=["a"]), "names"),
    "reference": (lambda: LOOP.step([0, 0], reference=1), "references"),
    "step": (lambda: LOOP.run([0, 0], step=3), "steps"),
    "timelimit": (lambda: lfo.Solver(lfo.library.double_integrator()).solve(timelimit=1), "time_limit"),
}


@pytest.mark.parametrize("name", MISSPELT)
def test_a_misspelt_keyword_is_answered_by_the_nearest(name):
    call, nearest = MISSPELT[name]
    with pytest.raises(lfo.errors.ProblemError, match=f"Did you mean '{nearest}'"):
        call()


CALLABLE = [
    (space, name)
    for space in lfo.NAMESPACES
    if space not in ("results", "errors")  # which users do not make
    for name in getattr(lfo, space).__all__
    if name not in ("Everything", "RobustProblem")  # one takes nothing, one any keyword of a problem
]


@pytest.mark.parametrize(("space", "name"), CALLABLE)
def test_every_public_function_and_class_answers_an_unknown_keyword(space, name):
    public = getattr(getattr(lfo, space), name)
    with pytest.raises(lfo.errors.ProblemError, match=r"unheard_of: got 1; expected one of the keywords (?!self)"):
        public(unheard_of=1)
    if name in lfo.__all__:
        assert public is getattr(lfo, name)
    if not isinstance(public, type):
        assert pickle.loads(pickle.dumps(public)) is public


def test_other_errors_of_a_call_stay_what_they_are():
    with pytest.raises(TypeError, match="positional"):
        lfo.Box(1, 2, 3)
    with pytest.raises(TypeError, match="missing"):
        lfo.compare()


def test_public_functions_can_be_sent_to_other_processes():
    for public in (lfo.solve, lfo.simulate, lfo.sweep, lfo.low_pass, lfo.Box, lfo.OptimalControlProblem):
        assert pickle.loads(pickle.dumps(public)) is public

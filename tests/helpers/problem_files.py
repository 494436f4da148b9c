"""Problems that files must carry, and what it means that two are the same."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, StageRows, low_pass, stop_band
from lin_freq_ocp.problem import Band
from lin_freq_ocp.sets import Everything
from lin_freq_ocp.spectrum import band_pass, high_pass


def bands(given) -> list[Band]:
    return [] if given is None else [given] if isinstance(given, Band) else list(given)


def assert_same(one: OptimalControlProblem, other: OptimalControlProblem) -> None:
    assert (one.name, one.horizon, one.sampling_time) == (other.name, other.horizon, other.sampling_time)
    assert (one.state_names, one.control_names) == (other.state_names, other.control_names)
    assert bands(one.control_spectrum) == bands(other.control_spectrum)
    assert bands(one.state_spectrum) == bands(other.state_spectrum)
    pairs = [
        *((getattr(one.dynamics, field), getattr(other.dynamics, field)) for field in ("A", "B", "offset")),
        *(
            (getattr(one.cost, f), getattr(other.cost, f))
            for f in ("Q", "R", "S", "q", "r", "P", "p", "x_ref", "u_ref")
        ),
        *(
            (getattr(getattr(one, box), side), getattr(getattr(other, box), side))
            for box in ("initial_state", "terminal_state", "state_tube", "control_tube")
            for side in ("lower", "upper")
        ),
        (one.control_stop, other.control_stop),
        (one.state_stop, other.state_stop),
        *((getattr(a, f), getattr(b, f)) for a, b in zip(one.stage_rows, other.stage_rows, strict=True) for f in "CDe"),
    ]
    assert [rows.name for rows in one.stage_rows] == [rows.name for rows in other.stage_rows]
    for a, b in pairs:
        assert a.shape == b.shape
        assert (a == b).all()


def everything_at_once(horizon: int) -> OptimalControlProblem:
    """Return a problem in which every field is given, per time where that is possible."""
    T, n, m = horizon, 3, 2
    rng = np.random.default_rng(7)
    root = rng.normal(size=(T, n + m, n + m))
    hessian = root @ np.swapaxes(root, 1, 2)
    hessian = (hessian + np.swapaxes(hessian, 1, 2)) / 2
    reach = rng.uniform(1, 2, size=(T + 1, n))
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            rng.normal(size=(T, n, n)),
            rng.normal(size=(T, n, m)),
            offset=rng.normal(size=(T, n)),
            sampling_time=1 / 3,
            state_names=["höhe [m]", 'a "quoted" [1]', "brackets, [ 1, ]"],
            control_names=["u\\v", "w"],
        ),
        horizon=T,
        cost=QuadraticCost(
            Q=hessian[:, :n, :n],
            R=hessian[:, n:, n:],
            S=hessian[:, :n, n:],
            q=rng.normal(size=(T, n)),
            r=rng.normal(size=(T, m)),
            P=hessian[0, :n, :n],
            p=rng.normal(size=n),
            x_ref=rng.normal(size=(T + 1, n)),
            u_ref=np.zeros((T, m)),
        ),
        control_set=[Everything() if t % 2 else Box([-1, None], [None, t]) for t in range(T)],
        state_set=Box(-reach, reach),
        initial_state=[0.1, -0.2, 0.3],
        terminal_state=Box([None, -0.5, 0.25], [0.5, None, 0.25]),
        control_spectrum=[low_pass(cutoff=0.8 * np.pi), stop_band(bins=[2, -1], component="w")],
        state_spectrum=[band_pass(lower_hz=0.1, upper_hz=1.4, component=1), high_pass(0.3, component="höhe")],
        stage_rows=[
            StageRows(rng.normal(size=(T, 2, n)), None, [1.0, np.inf], name="höhe [m]"),
            StageRows(None, rng.normal(size=(1, m)), rng.uniform(1, 2, size=(T, 1))),
        ],
        name="all of it",
    )

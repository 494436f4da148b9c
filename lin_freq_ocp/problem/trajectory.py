"""The objects of the theorem as plain data: a trajectory (x, u) and its multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, ComplexArray, assign, brief, complex_array, real_array, to_long_double
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import html_table, shape_and_range


@dataclass(frozen=True, eq=False, init=False)
class Trajectory:
    """States and controls over the horizon; whether they satisfy any dynamics is not checked.

    Parameters
    ----------
    x : (T+1, n)
        States x_0 .. x_T.
    u : (T, m)
        Controls u_0 .. u_{T-1}.

    Examples
    --------
    >>> lfo.Trajectory(x=[[0.0], [1.0]], u=[[1.0]]).x.shape
    (2, 1)
    """

    x: Array
    u: Array

    def __init__(self, x: ArrayLike, u: ArrayLike):
        states, controls = real_array("trajectory.x", x), real_array("trajectory.u", u)
        if states.ndim != 2 or controls.ndim != 2 or len(states) != len(controls) + 1:
            got, expected = f"x {states.shape} and u {controls.shape}", "x of shape (T+1, n) and u of shape (T, m)"
            raise ProblemError("trajectory", got, f"{expected}: time is axis 0")
        assign(self, x=states, u=controls)

    @property
    def extended(self) -> Trajectory:
        """Return the trajectory in extended precision, for differences of large terms."""
        copy = object.__new__(Trajectory)
        assign(copy, x=to_long_double(self.x), u=to_long_double(self.u))
        return copy

    def __repr__(self) -> str:
        return f"Trajectory(x {shape_and_range(self.x)}, u {shape_and_range(self.u)})"

    def _repr_html_(self) -> str:
        return html_table("Trajectory", [(name, shape_and_range(values)) for name, values in vars(self).items()])


@dataclass(frozen=True, eq=False, init=False)
class Multipliers:
    """The multipliers of the maximum principle, with the signs of L = eta_C J + sum <eta_t, x_{t+1} - f_t> + ... .

    Parameters
    ----------
    eta_C : float
        1 for a normal extremal, 0 for an abnormal one.
    eta : (T, n)
        Adjoint (costate) of x_{t+1} = f_t(x_t, u_t).
    mu : (T+1, n), nu : (T, m)
        Normals to the state and control sets: positive at an active upper bound, negative at a lower one.
    rho_u : complex (T//2 + 1, m), rho_x : complex ((T+1)//2 + 1, n), (T//2 + 1, n) with periodic ends
        Frequency multipliers per DFT bin, zero where a bin is free; -rho is the derivative of the optimal
        cost with respect to that bin (and its conjugate).
    stage : mapping from name to (groups, dim)
        Multipliers of all other constraints and costs by name. Of joint rows C x_t + D u_t <= e_t: (T, rows), zero or
        above, zero where a row is not active. Of a term h(L(x, u)): a subgradient of h at each value of L; of a mask,
        the (Re, Im) of each bin's multiplier in the units of rho. A name that is absent has zeros.
    frequencies : mapping from name to (groups,) or (groups, 2), optional
        Of masks at every frequency: the frequencies, in rad/sample, of their multipliers in ``stage``; at all others
        they are zero. Of a residual vibration: natural frequency in Hz and damping ratio of the modes.
    weights : (T, modes), optional
        Of piecewise-affine dynamics: the share of each mode's derivatives in those of f_t, the same for states and
        controls. None for linear dynamics, or if the judge shall find them.

    Examples
    --------
    >>> multipliers = lfo.solve(lfo.library.double_integrator()).multipliers
    >>> multipliers.eta_C, multipliers.eta.shape
    (1.0, (200, 2))
    """

    eta_C: float
    eta: Array
    mu: Array
    nu: Array
    rho_u: ComplexArray
    rho_x: ComplexArray
    stage: Mapping[str, Array]
    weights: Array | None
    frequencies: Mapping[str, Array]

    def __init__(
        self,
        eta_C: float,
        eta: ArrayLike,
        mu: ArrayLike,
        nu: ArrayLike,
        rho_u: ArrayLike,
        rho_x: ArrayLike,
        stage: Mapping[str, ArrayLike] | None = None,
        weights: ArrayLike | None = None,
        frequencies: Mapping[str, ArrayLike] | None = None,
    ):
        value = real_array("multipliers.eta_C", eta_C)
        if value.ndim:
            raise ProblemError("multipliers.eta_C", brief(eta_C), "one number")
        real = {"eta": eta, "mu": mu, "nu": nu}
        arrays = {field: real_array(f"multipliers.{field}", given) for field, given in real.items()}
        spectra = {"rho_u": rho_u, "rho_x": rho_x}
        assign(self, eta_C=float(value), **arrays)
        assign(self, **{field: complex_array(f"multipliers.{field}", given) for field, given in spectra.items()})
        for field in ("eta", "nu"):
            _require_matrix(f"multipliers.{field}", arrays[field])
        T, n, m = len(self.eta), self.eta.shape[-1], self.nu.shape[-1]
        bins, closed = T // 2 + 1, (T // 2 + 1, n)  # the latter with periodic ends
        shapes = {"eta": (T, n), "mu": (T + 1, n), "nu": (T, m), "rho_u": (bins, m), "rho_x": ((T + 1) // 2 + 1, n)}
        for field, shape in shapes.items():
            got = getattr(self, field).shape
            if got != shape and (field, got) != ("rho_x", closed):
                raise ProblemError(f"multipliers.{field}", f"shape {got}", f"shape {shape}")
        stage = {} if stage is None else stage
        if not isinstance(stage, Mapping):
            expected = "a mapping from names of joint rows to arrays (T, rows)"
            raise ProblemError("multipliers.stage", brief(stage), expected)
        families = {name: real_array(f"multipliers.stage[{name!r}]", value) for name, value in stage.items()}
        for name, family in families.items():
            _require_matrix(f"multipliers.stage[{name!r}]", family)
        shares = None if weights is None else real_array("multipliers.weights", weights)
        if shares is not None and (shares.ndim != 2 or len(shares) != T or not shares.shape[1]):
            raise ProblemError("multipliers.weights", f"shape {shares.shape}", f"({T}, modes): one per time and mode")
        points = dict[str, Array]()
        for name, value in (frequencies or {}).items():
            field = f"multipliers.frequencies[{name!r}]"
            points[name] = values = real_array(field, value)
            count = len(families.get(name, values))
            if values.shape not in ((count,), (count, 2)):
                expected = f"({count},) or, for plants, ({count}, 2): one per row of its multipliers"
                raise ProblemError(field, f"shape {values.shape}", expected)
            if values.ndim == 1 and (values < 0).any():
                raise ProblemError(field, brief(values.tolist()), "frequencies from 0 rad/sample on")
            if values.ndim == 2 and ((values[:, 0] <= 0) | (values[:, 1] < 0) | (values[:, 1] >= 1)).any():
                expected = "a frequency above 0 Hz and a damping ratio from 0 to below 1, in each row"
                raise ProblemError(field, brief(values.tolist()), expected)
        assign(self, stage=families, weights=shares, frequencies=points)


def horizon_advice(horizon: int) -> str:
    """Return what fits a trajectory of another horizon."""
    return f"It fits horizon={horizon}; on the command line: --set horizon={horizon}."


@dataclass(frozen=True, eq=False)
class Extremals:
    """N trajectories of one problem, which differ in their initial states, with their multipliers; eta_C = 1.

    The first axis is over trajectories: x (N, T+1, n), u (N, T, m), eta (N, T, n), mu, nu as x and u, rho_u
    (N, bins, m), and of each term (N, groups, dim). A term without an entry has zeros.
    """

    x: Array
    u: Array
    eta: Array
    mu: Array
    nu: Array
    rho_u: ComplexArray
    stage: Mapping[str, Array]

    @property
    def trajectory(self) -> Trajectory:
        """Return the signals of all trajectories, with their first axis."""
        trajectory = object.__new__(Trajectory)
        assign(trajectory, x=self.x, u=self.u)
        return trajectory

    @property
    def multipliers(self) -> Multipliers:
        """Return the multipliers of all trajectories, with their first axis; stopped bins of states have none."""
        multipliers, none = object.__new__(Multipliers), np.zeros((1, self.x.shape[-1]), dtype=np.complex128)
        signals = {"eta": self.eta, "mu": self.mu, "nu": self.nu, "rho_u": self.rho_u, "rho_x": none}
        assign(multipliers, eta_C=1.0, **signals, stage=self.stage, weights=None, frequencies={})
        return multipliers


def _require_matrix(field: str, array: Array) -> None:
    if array.ndim != 2:
        raise ProblemError(field, f"shape {array.shape}", "two dimensions")

"""Piecewise-affine dynamics: x_{t+1} = A_i x_t + B_i u_t + d_i, mode i, where G_i x_t + H_i u_t <= h_i."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.arrays import Array, Indices, Mask, assign, brief, names, positive_number
from lin_freq_ocp.problem.dynamics import LinearDynamics
from lin_freq_ocp.problem.stage_rows import StageRows

BORDER_TOLERANCE = 1e-6
"""A point this far beyond a facet of a region, relative to the largest terms of its row, is still on it: solvers meet
rows to 1e-8 or so, and the judge forgives 1e-6. The terms are those of the trajectory, or of ``ModeArrays.least_x``."""

SAME_IMAGE = 4 * BORDER_TOLERANCE
"""Two modes lead to the same state if their images differ by less, relative to the largest sum of absolute terms: those
of a continuous map differ by |g| times the distance from the facet, which is at most BORDER_TOLERANCE of |g h'| times
the terms for each of the two, and |g h'| <= |F_1| + |F_2|."""

REPLAY_ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""A replay takes the first mode whose region holds the point up to this rounding, relative to the terms of its rows."""

REGION = "mode region"
"""The name under which the region rows of a fixed mode sequence, and their multipliers, stand."""

OWN_FIELDS = {"dynamics.A": "A", "dynamics.B": "B", "dynamics.offset": "offset", "stage_rows.C": "G"} | {
    "stage_rows.D": "H",
    "stage_rows.e": "h",
}


@dataclass(frozen=True, eq=False, init=False)
class AffineMode:
    """One piece of the dynamics, and the polyhedron in (x, u) where it holds.

    Parameters
    ----------
    A : (n, n) or (T, n, n), B : (n, m) or (T, n, m), offset : (n,) or (T, n), optional
        x_{t+1} = A x_t + B u_t + offset.
    G : (rows, n) or (T, rows, n), H : (rows, m) or (T, rows, m), h : (rows,) or (T, rows)
        The region G x_t + H u_t <= h; one of G and H may be missing, and all three for a mode that holds everywhere.
    name : str
        As reports show it; default "mode i".

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not numbers.
    """

    linear: LinearDynamics
    region: StageRows
    name: str

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        offset: ArrayLike | None = None,
        G: ArrayLike | None = None,
        H: ArrayLike | None = None,
        h: ArrayLike | None = None,
        name: str = "",
    ):
        if not isinstance(name, str) or not (name.isprintable() or not name):
            raise ProblemError("mode.name", brief(name), "printable characters")
        try:
            linear = LinearDynamics(A, B, offset)
            n, m = linear.state_dim, linear.control_dim
            if h is None and (G is not None or H is not None):
                raise ProblemError("stage_rows.e", "None", "one limit per row of the region")
            if h is None:
                G, H, h = np.zeros((1, n)), np.zeros((1, m)), [np.inf]
            region = StageRows(G, H, h, REGION)
            for field, given, dimension in (("C", G, n), ("D", H, m)):
                if given is not None and getattr(region, field).shape[-1] != dimension:
                    shape = getattr(region, field).shape
                    raise ProblemError(f"stage_rows.{field}", f"shape {shape}", f"{dimension} columns")
        except ProblemError as error:
            own = next((own for known, own in OWN_FIELDS.items() if error.field.startswith(known)), error.field)
            raise ProblemError(f"mode.{own}", error.got, error.expected, error.advice) from None
        assign(self, linear=linear, region=region, name=name)


@dataclass(frozen=True, eq=False)
class ModeArrays:
    """All modes at all times, with rows of regions filled up by 0 <= inf.

    Attributes
    ----------
    A : (T, modes, n, n), B : (T, modes, n, m), offset : (T, modes, n)
    G : (T, modes, rows, n), H : (T, modes, rows, m), h : (T, modes, rows)
    least_x : (n,), least_u : (m,)
        What |x_t| and |u_t| count as at least, where sizes of rows and images are asked for; 0 if not said.
    """

    A: Array
    B: Array
    offset: Array
    G: Array
    H: Array
    h: Array
    least_x: Array = field(default_factory=lambda: np.zeros(()))
    least_u: Array = field(default_factory=lambda: np.zeros(()))

    def images(self, x: Array, u: Array) -> Array:
        """Return what each mode makes of (x_t, u_t), shape (T, modes, n); x is (T+1, n) or (T, n)."""
        through_x = np.einsum("tkij,tj->tki", self.A, x[: len(u)])
        return through_x + np.einsum("tkij,tj->tki", self.B, u) + self.offset

    def excess(self, x: Array, u: Array) -> Array:
        """Return G x_t + H u_t - h per row of each region, (T, modes, rows); -inf where there is no row."""
        return np.einsum("tkrj,tj->tkr", self.G, x[: len(u)]) + np.einsum("tkrj,tj->tkr", self.H, u) - self.h

    def row_sizes(self, x: Array, u: Array) -> Array:
        """Return what an excess is measured by, (modes, rows): the largest sum of absolute terms of its row over t."""
        limits, (x, u) = np.where(np.isfinite(self.h), np.abs(self.h), 0.0), self._sizes(x, u)
        terms = np.einsum("tkrj,tj->tkr", np.abs(self.G), x) + np.einsum("tkrj,tj->tkr", np.abs(self.H), u) + limits
        largest = terms.max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def distance(self, x: Array, u: Array) -> Array:
        """Return by how much (x_t, u_t) lies outside each region, relative to the sizes of its rows; (T, modes)."""
        return np.maximum((self.excess(x, u) / self.row_sizes(x, u)).max(axis=2), 0.0)

    def touching(self, x: Array, u: Array) -> Mask:
        """Which rows of each region (x_t, u_t) lies on, or beyond, within BORDER_TOLERANCE; (T, modes, rows)."""
        return self.excess(x, u) >= -BORDER_TOLERANCE * self.row_sizes(x, u)

    def active(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t), within BORDER_TOLERANCE; (T, modes)."""
        return self.distance(x, u) <= BORDER_TOLERANCE

    def sequence(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of those that hold, the one that leads nearest to x_{t+1}.

        Where none holds, the one whose region is nearest; x is (T+1, n), u is (T, m).
        """
        miss = np.abs(x[1:, None] - self.images(x, u)).max(axis=2)
        distance = self.distance(x, u)
        outside = np.where(distance <= BORDER_TOLERANCE, 0.0, distance)
        nearest = outside <= outside.min(axis=1, keepdims=True)
        return np.argmin(np.where(nearest, miss, np.inf), axis=1)

    def meeting(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t) and lead to the same state as that of ``sequence``, itself one; (T, modes).

        Of a continuous map, all that hold; of one that jumps, those on the trajectory's side.
        """
        times, sequence = np.arange(len(u)), self.sequence(x, u)
        images, active = self.images(x, u), self.active(x, u)
        x, u = self._sizes(x, u)
        terms = np.einsum("tkij,tj->tki", np.abs(self.A), x) + np.einsum("tkij,tj->tki", np.abs(self.B), u)
        terms += np.abs(self.offset)
        active[times, sequence] = True
        sizes = np.where(active[..., None], terms, 0.0).max(axis=(0, 1))
        here = images[times, sequence][:, None]
        return active & (np.abs(images - here) <= SAME_IMAGE * sizes).all(axis=2)

    def _sizes(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return |x_t| and |u_t|, t < T, or what they count as at least."""
        return np.maximum(np.abs(x[: len(u)]), self.least_x), np.maximum(np.abs(u), self.least_u)


@dataclass(frozen=True, eq=False, init=False)
class PiecewiseAffineDynamics:
    """x_{t+1} = A_i x_t + B_i u_t + d_i in the region of mode i.

    Regions must cover the problem's state and control sets and overlap on borders only; a problem checks both. On the
    border of a map that jumps there, an optimiser may choose either mode, and a replay takes the first listed.

    Parameters
    ----------
    modes : sequence of AffineMode
        At least one, with the same numbers of states and controls.
    sampling_time : float, optional
        Seconds per step. Needed wherever a frequency is given in Hz.
    state_names, control_names : sequences of str, optional
        One name per component, with its unit in brackets: ``"position [m]"``.

    Raises
    ------
    ProblemError
        If there is no mode, or their dimensions differ.
    """

    modes: tuple[AffineMode, ...]
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]

    def __init__(
        self,
        modes: Sequence[AffineMode],
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ):
        if not isinstance(modes, Sequence) or not modes or not all(isinstance(mode, AffineMode) for mode in modes):
            raise ProblemError("dynamics.modes", brief(modes), "a list of at least one AffineMode")
        n, m = modes[0].linear.state_dim, modes[0].linear.control_dim
        for i, mode in enumerate(modes):
            got = mode.linear.state_dim, mode.linear.control_dim
            if got != (n, m):
                raise ProblemError(
                    f"dynamics.modes[{i}]", f"{got[0]} states and {got[1]} controls", f"{n} and {m}, as in the first"
                )
        step = None if sampling_time is None else positive_number("dynamics.sampling_time", sampling_time)
        assign(
            self,
            modes=tuple(modes),
            sampling_time=step,
            state_names=names("dynamics.state_names", state_names, n, "x"),
            control_names=names("dynamics.control_names", control_names, m, "u"),
        )

    @property
    def state_dim(self) -> int:
        """Return n."""
        return self.modes[0].linear.state_dim

    @property
    def control_dim(self) -> int:
        """Return m."""
        return self.modes[0].linear.control_dim

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Return the name of every mode."""
        return tuple(mode.name or f"mode {i}" for i, mode in enumerate(self.modes))

    @cached_property
    def time_varying(self) -> bool:
        """Whether any map or region depends on time."""
        return any(
            mode.linear.time_varying
            or mode.linear.offset.ndim > 1
            or mode.region.time_varying
            or mode.region.e.ndim > 1
            for mode in self.modes
        )

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless everything given per time is given for ``horizon`` steps."""
        for i, mode in enumerate(self.modes):
            try:
                mode.linear.require_horizon(horizon)
                mode.region.at_dimensions(self.state_dim, self.control_dim, horizon, "dynamics")
            except ProblemError as error:
                own = error.field.removeprefix("dynamics.")
                own = {"C": "G", "D": "H", "e": "h"}.get(own, own)
                raise ProblemError(f"dynamics.modes[{i}].{own}", error.got, error.expected, error.advice) from None

    def arrays(self, horizon: int) -> ModeArrays:
        """Return all modes at all times."""
        n, m = self.state_dim, self.control_dim
        regions = [mode.region.at_dimensions(n, m, horizon, "dynamics") for mode in self.modes]
        most = max(region.rows for region in regions)

        def stacked(parts: Sequence[Array], ndim: int) -> Array:
            per_time = [part if part.ndim > ndim else part[None] for part in parts]
            return np.stack([np.broadcast_to(part, (horizon, *part.shape[1:])) for part in per_time], axis=1)

        def filled(part: Array, axis: int, value: float) -> Array:
            pad = [(0, 0)] * part.ndim
            pad[axis] = (0, most - part.shape[axis])
            return np.pad(part, pad, constant_values=value)

        return ModeArrays(
            A=stacked([mode.linear.A for mode in self.modes], 2),
            B=stacked([mode.linear.B for mode in self.modes], 2),
            offset=stacked([mode.linear.offset for mode in self.modes], 1),
            G=stacked([filled(region.C, -2, 0.0) for region in regions], 2),
            H=stacked([filled(region.D, -2, 0.0) for region in regions], 2),
            h=stacked([filled(region.e, -1, np.inf) for region in regions], 1),
        )

    def gains(self) -> tuple[Array, Array, Array]:
        """Return the largest |A| (n, n), |B| (n, m) and |d| (n,) over modes and times."""
        parts = [mode.linear.gains() for mode in self.modes]
        A, B, d = (np.max([part[k] for part in parts], axis=0) for k in range(3))
        return A, B, d

    def along(self, sequence: Indices) -> LinearDynamics:
        """Return the time-varying linear dynamics of a mode sequence (T,)."""
        arrays, times = self.arrays(len(sequence)), np.arange(len(sequence))
        A, B, offset = (part[times, sequence] for part in (arrays.A, arrays.B, arrays.offset))
        return LinearDynamics(A, B, offset, self.sampling_time, self.state_names, self.control_names)

    def averaged(self, weights: Array) -> LinearDynamics:
        """Return sum_i alpha_{t,i} (A_i, B_i, d_i), the element of Clarke's Jacobian with the weights (T, modes)."""
        arrays = self.arrays(len(weights))
        A, B = (np.einsum("tk,tkij->tij", weights, part) for part in (arrays.A, arrays.B))
        offset = np.einsum("tk,tki->ti", weights, arrays.offset)
        return LinearDynamics(A, B, offset, self.sampling_time, self.state_names, self.control_names)

    def region_rows(self, sequence: Indices) -> StageRows:
        """Return the rows G x_t + H u_t <= h of the regions of a mode sequence (T,)."""
        arrays, times = self.arrays(len(sequence)), np.arange(len(sequence))
        G, H, h = (part[times, sequence] for part in (arrays.G, arrays.H, arrays.h))
        return StageRows(G, H, h, REGION)

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of those that hold, the one that leads nearest to x_{t+1}.

        Where none holds, the one whose region is nearest; x is (T+1, n), u is (T, m).
        """
        return self.arrays(len(u)).sequence(x, u)

    def stepper(self, horizon: int) -> Callable[[int, Array, Array], Array]:
        """Return the function that makes x_{t+1} of t, x_t (n,) and u_t (m,), by the first mode that holds there.

        It raises NumericalError where no region holds (x_t, u_t): the state has left the sets that the regions cover.
        """
        arrays = self.arrays(horizon)
        limits = np.where(np.isfinite(arrays.h), np.abs(arrays.h), 0.0)

        def step(t: int, x: Array, u: Array) -> Array:
            excess = arrays.G[t] @ x + arrays.H[t] @ u - arrays.h[t]
            size = np.abs(arrays.G[t]) @ np.abs(x) + np.abs(arrays.H[t]) @ np.abs(u) + limits[t]
            holds = (excess <= REPLAY_ROUNDING * size).all(axis=1)
            if not holds.any():
                raise NumericalError(f"No mode of the dynamics holds at t = {t}, x = {brief(x.tolist())}.")
            i = int(np.argmax(holds))
            return arrays.A[t, i] @ x + arrays.B[t, i] @ u + arrays.offset[t, i]

        return step


def as_sequence(field: str, sequence: Any, horizon: int, modes: int) -> Indices:
    """Return a mode sequence as integers (T,), or raise ProblemError."""
    given = np.asarray(sequence)
    expected = f"{horizon} mode numbers from 0 to {modes - 1}"
    if given.shape != (horizon,) or given.dtype.kind not in "iu":
        raise ProblemError(field, f"shape {given.shape} of {given.dtype}", expected)
    if (given < 0).any() or (given >= modes).any():
        raise ProblemError(field, brief(given.tolist()), expected)
    return given.astype(np.intp)

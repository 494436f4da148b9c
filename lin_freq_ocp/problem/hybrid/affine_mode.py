"""Modes of piecewise-affine dynamics: an affine map and the polyhedron in (x, u) where it holds.

``ModeArrays`` has all modes at all times: their images of a trajectory, and which of them hold where.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, Mask, assign, brief, real_array, upper_limits
from lin_freq_ocp.base.errors import ProblemError, located_at, rename_field
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.linearisation import ControlSystem
from lin_freq_ocp.problem.sets.stage_rows import StageRows

# A point this far outside a facet of a region, relative to the size of its row, counts as on the facet: solvers
# violate rows by about 1e-8, and the judge accepts 1e-6.
FACET_TOLERANCE = 1e-6
# Two modes lead to the same state if their images differ by less, relative to the largest sum of absolute terms. The
# images of a continuous map differ by |g| times the distance from the facet. For each mode that is at most
# FACET_TOLERANCE of |g h'| times the terms, and |g h'| <= |F_1| + |F_2|.
SAME_IMAGE = 4 * FACET_TOLERANCE
# The size of a component is at least this fraction of the size that the problem states, as in the judge; the size of a
# control with levels at least its levels.
LEAST_SIZE = 1e-4
# A simulation takes the first mode whose region contains the point up to this rounding, relative to the terms of its
# rows.
SIMULATION_ROUNDING = 16 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class ModeArrays:
    """All modes at all times; rows 0 <= inf pad the regions to the same number of rows."""

    A: Array  # (T, modes, n, n)
    B: Array  # (T, modes, n, m)
    offset: Array  # (T, modes, n)
    G: Array  # (T, modes, rows, n)
    H: Array  # (T, modes, rows, m)
    h: Array  # (T, modes, rows)
    least: tuple[Array, Array]  # (n,) and (m,): the smallest sizes of states and controls; zeros if unknown

    def with_sizes(self, x: Array, u: Array, levels: Array) -> ModeArrays:
        """Return the same modes with known sizes of states (n,), controls (m,) and levels (m,)."""
        return replace(self, least=(LEAST_SIZE * x, np.maximum(LEAST_SIZE * u, levels)))

    @cached_property
    def maps(self) -> Array:
        """[A, B] of every mode, (T, modes, n, n + m)."""
        return np.concatenate([self.A, self.B], axis=-1)

    @cached_property
    def rows(self) -> Array:
        """[G, H] of every region, (T, modes, rows, n + m)."""
        return np.concatenate([self.G, self.H], axis=-1)

    def sizes(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return the sizes of states, (n,), and controls, (m,), along a trajectory, to which rounding is relative.

        A state that stays at zero, on a switching boundary, has the size of the terms of its map, those of the mode
        with the smallest ones.
        """
        largest = np.abs(x).max(axis=0), np.maximum(np.abs(u).max(axis=0), self.least[1])
        terms = np.einsum("tkij,tj->tki", _absolute(self.A), np.abs(x[: len(u)]))
        terms += np.einsum("tkij,tj->tki", _absolute(self.B), np.abs(u)) + _absolute(self.offset)
        return np.maximum.reduce([largest[0], terms.min(axis=1).max(axis=0), self.least[0]]), largest[1]

    def images(self, x: Array, u: Array) -> Array:
        """Return the image of (x_t, u_t) under each mode, (T, modes, n); x is (T+1, n) or (T, n)."""
        through_x = np.einsum("tkij,tj->tki", self.A, x[: len(u)])
        return through_x + np.einsum("tkij,tj->tki", self.B, u) + self.offset

    def image_sizes(self, x: Array, u: Array, modes: Mask) -> Array:
        """Return the sizes that differences of images are relative to, (n,): absolute terms of modes (T, modes)."""
        of_x, of_u = self.sizes(x, u)
        terms = _absolute(self.A) @ of_x + _absolute(self.B) @ of_u + _absolute(self.offset)
        return np.where(modes[..., None], terms, 0.0).max(axis=(0, 1))

    def excess(self, x: Array, u: Array) -> Array:
        """Return G x_t + H u_t - h for every row of each region, (T, modes, rows); -inf for padding."""
        return np.einsum("tkrj,tj->tkr", self.G, x[: len(u)]) + np.einsum("tkrj,tj->tkr", self.H, u) - self.h

    def row_sizes(self, x: Array, u: Array) -> Array:
        """Return the size of each row, (modes, rows): its terms for components of their sizes."""
        of_x, of_u = self.sizes(x, u)
        limits = np.where(np.isfinite(self.h), np.abs(self.h), 0.0)
        largest = (_absolute(self.G) @ of_x + _absolute(self.H) @ of_u + limits).max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def distance(self, x: Array, u: Array) -> Array:
        """Return the distance of (x_t, u_t) from each region, relative to the sizes of its rows, (T, modes)."""
        return np.maximum((self.excess(x, u) / self.row_sizes(x, u)).max(axis=2), 0.0)

    def active_facets(self, x: Array, u: Array) -> Mask:
        """Which rows of each region are active or violated at (x_t, u_t), within FACET_TOLERANCE, (T, modes, rows)."""
        return self.excess(x, u) >= -FACET_TOLERANCE * self.row_sizes(x, u)

    def active(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t), within FACET_TOLERANCE, (T, modes)."""
        return self.distance(x, u) <= FACET_TOLERANCE

    def sequence(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of the modes that hold, the one with the image nearest to x_{t+1}.

        Distances are sums over components relative to their sizes; of images equally near, up to rounding, the first.
        If no mode holds, the modes with the nearest regions count; x is (T+1, n), u is (T, m).
        """
        distance = self.distance(x, u)
        outside = np.where(distance <= FACET_TOLERANCE, 0.0, distance)
        nearest = outside <= outside.min(axis=1, keepdims=True)
        sizes = self.image_sizes(x, u, nearest)
        relative = np.abs(x[1:, None] - self.images(x, u)) / np.where(sizes > 0, sizes, 1.0)
        miss = np.where(nearest, relative.sum(axis=2), np.inf)
        return np.argmax(miss <= miss.min(axis=1, keepdims=True) + SIMULATION_ROUNDING, axis=1)

    def active_modes(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t) and lead to the same state as the mode of ``sequence``, (T, modes).

        Those are all modes that hold if the map is continuous, and those on the trajectory's side if it jumps.
        """
        times, sequence = np.arange(len(u)), self.sequence(x, u)
        images, active = self.images(x, u), self.active(x, u)
        active[times, sequence] = True
        sizes = self.image_sizes(x, u, active)
        image = images[times, sequence][:, None]
        return active & (np.abs(images - image) <= SAME_IMAGE * sizes).all(axis=2)


def _absolute(part: Array) -> Array:
    """Return the absolute values; data that are stored once for all times stay so."""
    return np.abs(part) if part.strides[0] else np.broadcast_to(np.abs(part[:1]), part.shape)


REGION = "mode region"  # the name of the region rows of a mode sequence, and of their multipliers
MODE = "mode"  # the field that errors name until ``located_at`` names the mode


@dataclass(frozen=True, eq=False, init=False)
class AffineMode:
    """An affine map of piecewise-affine dynamics, and the polyhedron in (x, u) where it holds.

    Parameters
    ----------
    A : (n, n) or (T, n, n), B : (n, m) or (T, n, m), offset : (n,) or (T, n), optional
        x_{t+1} = A x_t + B u_t + offset.
    G : (rows, n) or (T, rows, n), H : (rows, m) or (T, rows, m), h : (rows,) or (T, rows)
        The region G x_t + H u_t <= h; one of G and H may be missing, and all three for a mode that holds everywhere.
        inf in h: no limit.
    name : str
        The name in reports; default "mode i".

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not numbers. The field is ``mode.A``, or ``dynamics.modes[i].A`` where the
        location is known.

    Examples
    --------
    >>> lfo.AffineMode([[0.5]], [[1.0]], G=[[-1.0]], h=[0.0], name="right").name  # holds where x >= 0
    'right'
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
        if not isinstance(name, str) or not name.isprintable() or (name and not name.strip()):
            raise ProblemError(f"{MODE}.name", brief(name), "a name of printable characters")
        with located_at(MODE, "dynamics"):
            linear = LinearDynamics(A, B, offset)
        n, m = linear.state_dim, linear.control_dim
        without_rows = G is None and H is None
        if h is None and not without_rows:
            raise ProblemError(f"{MODE}.h", "None", "one limit per row of the region G x + H u <= h")
        limits = upper_limits(f"{MODE}.h", [np.inf] if h is None else h)
        if limits.ndim not in (1, 2) or limits.shape[-1] == 0:
            expected = "shape (rows,), one limit per row of the region, or (T, rows) with one per time"
            raise ProblemError(f"{MODE}.h", f"shape {limits.shape}", expected)
        if h is not None and without_rows:
            raise ProblemError(f"{MODE}.G", "neither G nor H", "at least one of them, for the rows of h")
        rows = limits.shape[-1]
        region = StageRows(_coefficients("G", G, rows, n), _coefficients("H", H, rows, m), limits, REGION)
        assign(self, linear=linear, region=region, name=name)

    def translated(self, origin: Array, horizon: int) -> AffineMode:
        """Return the mode of x - origin, origin (n,)."""
        linear, region = self.linear.translated(origin, horizon), self.region.translated(origin)
        return AffineMode(linear.A, linear.B, linear.offset, region.C, region.D, region.e, self.name)

    @property
    def everywhere(self) -> bool:
        """Whether no row of the region limits anything."""
        return bool(np.isinf(self.region.e).all())


def _coefficients(field: str, coefficients: ArrayLike | None, rows: int, columns: int) -> Array:
    if coefficients is None:
        return np.zeros((rows, columns))
    matrix = real_array(f"{MODE}.{field}", coefficients)
    if matrix.ndim not in (2, 3) or matrix.shape[-2:] != (rows, columns):
        expected = f"shape {(rows, columns)}, one row per limit in h, or (T, {rows}, {columns}) with one per time"
        advice = "A single row is a matrix with one row: [[g_1, g_2, ...]]."
        raise ProblemError(f"{MODE}.{field}", f"shape {matrix.shape}", expected, advice)
    return matrix


@dataclass(frozen=True, eq=False)
class SmoothPiece:
    """A nonlinear model, the point of its linearisation, and the region where the linear model holds.

    Parameters
    ----------
    system : control.NonlinearIOSystem
        Continuous or discrete, from ``control.nlsys``.
    x, u : (n,) and (m,), or (T+1, n) and (T, m)
        The point, or a trajectory for matrices per time.
    G, H, h : as for AffineMode
        The region G x_t + H u_t <= h.
    name : str
    params, state_scale, control_scale, integrator
        As for ``LinearDynamics.linearised``.

    Examples
    --------
    >>> import control
    >>> model = control.nlsys(lambda t, x, u, params: [x[0] ** 2 + u[0]], None, states=1, inputs=1, dt=0.1)
    >>> piece = lfo.dynamics.SmoothPiece(model, [1.0], [0.0], name="near 1")
    >>> lfo.PiecewiseAffineDynamics.linearised([piece]).mode_names
    ('near 1',)
    """

    system: ControlSystem
    x: ArrayLike
    u: ArrayLike
    G: ArrayLike | None = None
    H: ArrayLike | None = None
    h: ArrayLike | None = None
    name: str = ""
    params: Mapping[str, object] | None = None
    state_scale: ArrayLike | None = None
    control_scale: ArrayLike | None = None
    integrator: str = "DOP853"


def linearised_modes(
    pieces: Sequence[SmoothPiece], sampling_time: float | None
) -> tuple[list[AffineMode], LinearDynamics]:
    """Return the modes of ``PiecewiseAffineDynamics.linearised`` and the linearisation of the first piece."""
    if not isinstance(pieces, Sequence) or isinstance(pieces, str) or not pieces:
        raise ProblemError("pieces", brief(pieces), "a list of at least one SmoothPiece")
    modes: list[AffineMode] = []
    maps: list[LinearDynamics] = []
    for i, piece in enumerate(pieces):
        location = f"pieces[{i}]"
        if not isinstance(piece, SmoothPiece):
            raise ProblemError(location, brief(piece), "a SmoothPiece")
        with rename_field(lambda field, at=location: field if field.endswith("sampling_time") else f"{at}.{field}"):
            linear = LinearDynamics.linearised(
                piece.system,
                piece.x,
                piece.u,
                sampling_time,
                piece.params,
                state_scale=piece.state_scale,
                control_scale=piece.control_scale,
                integrator=piece.integrator,
            )
        steps = [model.sampling_time or 0.0 for model in (linear, *maps[:1])]
        if not np.isclose(steps[0], steps[-1], rtol=1e-12, atol=0.0):
            expected = f"{maps[0].sampling_time}, as in the first piece"
            raise ProblemError(f"{location}.system.dt", f"{linear.sampling_time}", expected)
        with located_at(location, MODE):
            modes.append(AffineMode(linear.A, linear.B, linear.offset, piece.G, piece.H, piece.h, piece.name))
        maps.append(linear)
    return modes, maps[0]

"""Modes of piecewise-affine dynamics: an affine map and the polyhedron in (x, u) where it holds."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.linearisation import System
from lin_freq_ocp.problem.sets.stage_rows import StageRows

REGION = "mode region"  # the name under which the region rows of a fixed mode sequence, and their multipliers, stand
MODE = "mode"  # the field that errors name until ``located_at`` names the mode


@dataclass(frozen=True, eq=False, init=False)
class AffineMode:
    """One piece of the dynamics, and the polyhedron in (x, u) where it holds.

    Parameters
    ----------
    A : (n, n) or (T, n, n), B : (n, m) or (T, n, m), offset : (n,) or (T, n), optional
        x_{t+1} = A x_t + B u_t + offset.
    G : (rows, n) or (T, rows, n), H : (rows, m) or (T, rows, m), h : (rows,) or (T, rows)
        The region G x_t + H u_t <= h; one of G and H may be missing, and all three for a mode that holds everywhere.
        inf in h: no limit.
    name : str
        As reports show it; default "mode i".

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not numbers; of the field ``mode.A``, or ``dynamics.modes[i].A`` where the
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
        assign(self, linear=linear, region=_region(G, H, h, linear.state_dim, linear.control_dim), name=name)

    def translated(self, origin: Array) -> AffineMode:
        """Return the mode of x - origin, origin (n,)."""
        linear, region = self.linear.translated(origin), self.region.translated(origin)
        return AffineMode(linear.A, linear.B, linear.offset, region.C, region.D, region.e, self.name)

    @property
    def everywhere(self) -> bool:
        """Whether no row of the region limits anything."""
        return bool(np.isinf(self.region.e).all())


@contextmanager
def located_at(location: str, own: str = MODE) -> Generator[None]:
    """Let a ProblemError that names the field ``own``, or one within, name it at ``location`` instead."""
    try:
        yield
    except ProblemError as error:
        rest = error.field.removeprefix(own)
        field = location + rest if rest != error.field else f"{location}: {error.field}"
        raise ProblemError(field, error.got, error.expected, error.advice) from None


def _region(G: ArrayLike | None, H: ArrayLike | None, h: ArrayLike | None, n: int, m: int) -> StageRows:
    if h is None:
        if G is not None or H is not None:
            raise ProblemError(f"{MODE}.h", "None", "one limit per row of the region G x + H u <= h")
        return StageRows(np.zeros((1, n)), np.zeros((1, m)), [np.inf], REGION)
    limits = real_array(f"{MODE}.h", h, allow_infinite=True)
    if limits.ndim not in (1, 2) or limits.shape[-1] == 0:
        expected = "shape (rows,), one limit per row of the region, or (T, rows) with one per time"
        raise ProblemError(f"{MODE}.h", f"shape {limits.shape}", expected)
    if (limits == -np.inf).any():
        where = "".join(f"[{i}]" for i in np.argwhere(limits == -np.inf)[0])
        raise ProblemError(f"{MODE}.h{where}", "-inf", "a number, or inf for no limit")
    if G is None and H is None:
        raise ProblemError(f"{MODE}.G", "neither G nor H", "at least one of them, for the rows of h")
    rows = limits.shape[-1]
    return StageRows(_coefficients("G", G, rows, n), _coefficients("H", H, rows, m), limits, REGION)


def _coefficients(field: str, given: ArrayLike | None, rows: int, columns: int) -> Array:
    if given is None:
        return np.zeros((rows, columns))
    matrix = real_array(f"{MODE}.{field}", given)
    if matrix.ndim not in (2, 3) or matrix.shape[-2:] != (rows, columns):
        expected = f"shape {(rows, columns)}, one row per limit in h, or (T, {rows}, {columns}) with one per time"
        advice = "A single row is a matrix with one row: [[g_1, g_2, ...]]."
        raise ProblemError(f"{MODE}.{field}", f"shape {matrix.shape}", expected, advice)
    return matrix


@dataclass(frozen=True, eq=False)
class SmoothPiece:
    """A nonlinear model, the point to linearise it at, and the region where it holds.

    Parameters
    ----------
    system : control.NonlinearIOSystem
        Continuous or discrete, from ``control.nlsys``.
    x, u : (n,) and (m,), or (T+1, n) and (T, m)
        Where: a point, or a trajectory for matrices per time.
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

    system: System
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
    """Return the modes of ``PiecewiseAffineDynamics.linearised``, and the linearisation of the first piece."""
    if not isinstance(pieces, Sequence) or isinstance(pieces, str) or not pieces:
        raise ProblemError("pieces", brief(pieces), "a list of at least one SmoothPiece")
    modes: list[AffineMode] = []
    maps: list[LinearDynamics] = []
    for i, piece in enumerate(pieces):
        location = f"pieces[{i}]"
        if not isinstance(piece, SmoothPiece):
            raise ProblemError(location, brief(piece), "a SmoothPiece")
        try:
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
        except ProblemError as error:
            field = error.field if error.field.endswith("sampling_time") else f"{location}.{error.field}"
            raise ProblemError(field, error.got, error.expected, error.advice) from None
        steps = [one.sampling_time or 0.0 for one in (linear, *maps[:1])]
        if not np.isclose(steps[0], steps[-1], rtol=1e-12, atol=0.0):
            expected = f"{maps[0].sampling_time}, as in the first piece"
            raise ProblemError(f"{location}.system.dt", f"{linear.sampling_time}", expected)
        with located_at(location):
            modes.append(AffineMode(linear.A, linear.B, linear.offset, piece.G, piece.H, piece.h, piece.name))
        maps.append(linear)
    return modes, maps[0]

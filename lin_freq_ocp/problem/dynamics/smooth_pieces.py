"""Nonlinear models that hold in a region each, linearised at a point each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.dynamics.affine_mode import AffineMode, placed_at
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics


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
    """

    system: Any
    x: ArrayLike
    u: ArrayLike
    G: ArrayLike | None = None
    H: ArrayLike | None = None
    h: ArrayLike | None = None
    name: str = ""
    params: dict[str, Any] | None = None
    state_scale: ArrayLike | None = None
    control_scale: ArrayLike | None = None
    integrator: str = "DOP853"


def linearised_modes(
    pieces: Any, sampling_time: float | None, state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> tuple[list[AffineMode], float | None, Sequence[str] | None, Sequence[str] | None]:
    """Return the modes, the sampling time and the names; see ``PiecewiseAffineDynamics.linearised``."""
    if not isinstance(pieces, Sequence) or isinstance(pieces, str) or not pieces:
        raise ProblemError("pieces", brief(pieces), "a list of at least one SmoothPiece")
    modes: list[AffineMode] = []
    maps: list[LinearDynamics] = []
    for i, piece in enumerate(pieces):
        place = f"pieces[{i}]"
        if not isinstance(piece, SmoothPiece):
            raise ProblemError(place, brief(piece), "a SmoothPiece")
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
            field = error.field if error.field.endswith("sampling_time") else f"{place}.{error.field}"
            raise ProblemError(field, error.got, error.expected, error.advice) from None
        steps = [one.sampling_time or 0.0 for one in (linear, *maps[:1])]
        if not np.isclose(steps[0], steps[-1], rtol=1e-12, atol=0.0):
            expected = f"{maps[0].sampling_time}, as in the first piece"
            raise ProblemError(f"{place}.system.dt", f"{linear.sampling_time}", expected)
        with placed_at(place):
            modes.append(AffineMode(linear.A, linear.B, linear.offset, piece.G, piece.H, piece.h, piece.name))
        maps.append(linear)
    first = maps[0]
    return modes, first.sampling_time, state_names or first.state_names, control_names or first.control_names

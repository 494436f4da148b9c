"""What a solve needs, once per problem (Structure) and once per set of data (Data); docs/spectral.md, 1 to 5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, require_memory
from lin_freq_ocp.methods.spectral.kkt.bordered_system import BorderedSystem
from lin_freq_ocp.methods.spectral.model.kernels import Kernels
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.methods.spectral.model.spaces import BinSpaces
from lin_freq_ocp.methods.spectral.rows.violations import Violations
from lin_freq_ocp.methods.spectral.rows.whole_horizon import LARGEST, WholeHorizon
from lin_freq_ocp.methods.spectral.rows.working_set import WorkingSet

TEMPORARIES = 2.0  # memory at the peak over that of the arrays that are kept; 1.9 was measured


class Structure:
    """Null spaces, kernels and border of a problem; they depend on A, B, M, F, the bands and which ends are free.

    ``unconstrained`` (rows of F,) is 1/R for control rows and 0 for others if diag(1/R) - S >= 0 (R diagonal, S = 0).
    """

    def __init__(self, lti: Lti):
        _require_memory(lti)
        self.spaces = BinSpaces(lti)
        self.kernels = Kernels(lti, self.spaces)
        self.border = BorderedSystem(lti, self.spaces, self.kernels)
        self.unconstrained = _unconstrained_response(lti)
        self._whole: WholeHorizon | None = None

    def whole_horizon(self, rows: Indices) -> WholeHorizon | None:
        """Return the responses of all values of the rows of F; None if many, or with a soft border or periodic ends."""
        T, closed = self.border.lti.horizon, self.border.lti.periodic
        if closed or self.border.soft or not self.kernels.complete or not len(rows) or len(rows) * T > LARGEST:
            return None
        if self._whole is None or not np.array_equal(self._whole.rows, rows):
            self._whole = WholeHorizon(self.border, rows)
        return self._whole


def _require_memory(lti: Lti) -> None:
    """Raise UnsupportedError unless spectra, kernels and signals fit into memory (docs/spectral.md, Memory)."""
    dimension, rows = len(lti.M), len(lti.F)
    free = int(np.isnan(lti.start).sum() + np.isnan(lti.end).sum())
    spectra = 8 * dimension * lti.control_dim + 12 + 48 * dimension + 16 * dimension * free
    in_time = 4 * rows * (rows + 1) + 9 * rows + 2 * rows
    require_memory(
        f"method 'spectral' with horizon = {lti.horizon}, {lti.state_dim} states and {lti.control_dim} controls",
        TEMPORARIES * (spectra + in_time) * lti.horizon,
        "Choose a shorter horizon or a longer sampling time.",
    )
    bands = 2.0 * lti.state_stop.sum()
    require_memory(
        f"the state bands, {bands:.0f} dense rows with their responses,",
        16 * (dimension + 2) * bands * lti.horizon,
        "Stop bands of controls need no dense rows; else choose a shorter horizon.",
    )


def _unconstrained_response(lti: Lti) -> Array | None:
    n = lti.state_dim
    R = lti.M[n:, n:]
    if lti.M[:n, n:].any() or not np.array_equal(R, np.diag(np.diagonal(R))) or not np.diagonal(R).all():
        return None
    response = np.zeros(len(lti.F))
    response[n : n + lti.control_dim] = 1 / np.diagonal(R)
    return response


@dataclass(frozen=True, eq=False)
class Data:
    """What depends on ends, linear terms, offsets and bounds."""

    lti: Lti
    base: ComplexArray  # spectrum of y without forces and border variables, (n+m, bins)
    linear: ComplexArray | None  # spectrum of h, (n+m, bins)
    h: Array  # gradient in theta at 0, (size,)
    e: Array  # right-hand sides of the equations, (equations,)


def prepare(structure: Structure, lti: Lti) -> Data:
    """Return the data of ``lti``, whose structure must be the given one."""
    spaces, border = structure.spaces, structure.border
    start, end = np.where(np.isnan(lti.start), 0.0, lti.start), np.where(np.isnan(lti.end), 0.0, lti.end)
    jump = spaces.z * (start - end)[:, None]
    if lti.offset is not None:
        jump += fft.rfft(lti.offset)
    linear = None if lti.linear is None else fft.rfft(lti.linear)
    base = spaces.particular(jump[:, None])[:, 0]
    h = border.gradient(lti.M @ base + (0 if linear is None else linear))
    h[border.at_end] += (lti.P @ end + lti.p)[border.free_end]
    if linear is not None:
        base -= spaces.project(linear[:, None])[:, 0]
    return Data(lti, base, linear, h, border.right_hand_side(lti, jump))


class Unforced(NamedTuple):
    """The point without working rows: theta and multipliers of the equations together, and all bounded values."""

    step: Array
    values: Array


def unforced(structure: Structure, data: Data, violations: Violations, whole: WholeHorizon) -> Unforced:
    """Return the point without working rows, to the accuracy of K_b."""
    theta = np.zeros(structure.border.size)
    at, _ = signals(structure, data, theta, np.zeros(len(data.e)), WorkingSet(structure.border))
    step = structure.border.inverse @ np.concatenate([-data.h, equation_residual(structure, data, theta, at)])
    return Unforced(step, np.append(violations.values(at.y), at.last) + step @ whole.coupling)


@dataclass(frozen=True, eq=False)
class Signals:
    """A point: it satisfies the dynamics and the control bands to rounding."""

    y: Array  # (x_t, u_t), (n+m, T)
    last: Array  # x_T


def signals(
    structure: Structure, data: Data, theta: Array, multipliers: Array, working: WorkingSet
) -> tuple[Signals, ComplexArray]:
    """Return the optimum over all bins for given border variables and forces (docs/spectral.md, (3)), and its spectrum.

    The spectrum is that of y, (n+m, bins).
    """
    lti, spaces, border = data.lti, structure.spaces, structure.border
    spectrum = data.base.copy()
    if len(working) or multipliers.any():
        spaces.respond(*forces(structure, lti, multipliers, working), spectrum)
    border.add(theta, spectrum)
    y, last = fft.irfft(spectrum, lti.horizon), lti.end.copy()
    if lti.periodic:
        last[:] = y[: lti.state_dim, 0]
    last[border.free_end] = theta[border.at_end]
    return Signals(y, last), spectrum


def forces(structure: Structure, lti: Lti, multipliers: Array, working: WorkingSet) -> tuple[ComplexArray, Mask]:
    """Return the spectrum of G'l + E'y, and which components are not zero."""
    border, dimension = structure.border, len(lti.M)
    pulses = np.zeros((len(lti.F), lti.horizon))
    inner = working.inner
    np.add.at(pulses, (working.f[inner], working.t[inner]), (working.sign * working.weights)[inner])
    np.add.at(pulses, (border.point_f, border.point_t), multipliers[: len(border.point_t)])
    acting = np.zeros(len(lti.F), dtype=bool)
    acting[working.f[inner]] = True
    acting[border.point_f] |= bool(multipliers.any())
    force = pulses[:dimension]
    if acting[dimension:].any():
        force += lti.F[dimension:].T @ pulses[dimension:]
        acting[:dimension] |= lti.F[dimension:][acting[dimension:]].any(0)
    used = acting[:dimension]
    spectrum = np.zeros((dimension, len(structure.spaces.z)), dtype=np.complex128)
    if used.any():
        spectrum[used] = fft.rfft(force if used.all() else force[used])
    if len(border.bands):
        on_bands = multipliers[-len(border.bands) :]
        for i in border.band_components:
            mine = border.band_component == i
            spectrum[i] += on_bands[mine] @ border.band_hat[mine]
            used[i] = True
    return spectrum, used


def equation_residual(structure: Structure, data: Data, theta: Array, at: Signals) -> Array:
    """Return e - E(x, theta), measured on the signals where possible."""
    border, points = structure.border, len(structure.border.point_t)
    residual = data.e - border.E @ theta
    residual[:points] = data.e[:points] - at.y[border.point_f, border.point_t]
    residual[border.free_start] += theta[border.at_start]
    if len(border.bands):
        inside = np.einsum("dt,dt->d", border.bands[:, :-1], at.y[border.band_component])
        residual[-len(border.bands) :] = -inside - border.bands[:, -1] * at.last[border.band_component]
    return residual

"""Many initial states of one problem: working rows from the model of all values, then all signals at once.

The formulas are those of ``structure.signals`` and ``recovery``, by arrays with the problems first; for problems
without joint rows and state bands. Nothing is measured here: whoever asks judges the answers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.algorithm.ends_model import EndsModel
from lin_freq_ocp.methods.spectral.algorithm.structure import Structure
from lin_freq_ocp.methods.spectral.model.lti import Units
from lin_freq_ocp.methods.spectral.rows.whole_horizon import ActiveSetDuals, exchanged
from lin_freq_ocp.methods.spectral.rows.working_set import Rows


@dataclass(frozen=True, eq=False)
class Together:
    """Trajectories x (N, T+1, n), u (N, T, m) with eta (N, T, n), mu, nu as x and u, and rho_u (N, bins, m).

    ``found`` (N,) says for which a working set was found, ``rows`` is the last of these, to begin with.
    """

    x: Array
    u: Array
    eta: Array
    mu: Array
    nu: Array
    rho_u: ComplexArray
    found: Mask
    rows: Rows | None
    interrupted: bool = False


def fits(structure: Structure) -> bool:
    """Whether a problem has neither joint or soft rows nor state bands."""
    lti = structure.border.lti
    return len(lti.F) == len(lti.M) and lti.prices is None and not len(structure.border.bands)


def solve_together(
    structure: Structure,
    model: EndsModel,
    units: Units,
    starts: Array,
    first: Rows | None,
    tolerance: float,
    stop: Callable[[], str | None],
    failed: Callable[[int], None],
) -> Together:
    """Solve from initial states (N, n) one after the other, each from the working rows of the one before.

    ``failed`` is told which has no working set here: its ray may refute the next.
    """
    p = model.parameters(starts / units.x)
    step, values = p @ model.step, p @ model.values
    weights, found, rows = _working_sets(structure, model, values, first, tolerance, stop, failed)
    step -= weights @ model.whole.through.T
    answer = _Recovery(structure, model, p, step, weights)
    return answer.in_units(units, found, rows)


def _working_sets(
    structure: Structure,
    model: EndsModel,
    values: Array,
    first: Rows | None,
    tolerance: float,
    stop: Callable[[], str | None],
    failed: Callable[[int], None],
) -> tuple[Array, Mask, Rows | None]:
    """Return the multipliers of all values with signs, (N, values), where they were found, and the last rows."""
    whole, violations = model.whole, model.violations
    weights, found, rows = np.zeros(values.shape), np.zeros(len(values), dtype=bool), first
    none = np.zeros(0, dtype=np.intp)
    for i, base in enumerate(values):
        if stop():
            break
        if model.may_refute(base):
            continue
        start = ActiveSetDuals(none, np.zeros(0), np.zeros(0)) if rows is None else whole.duals(rows)
        duals = exchanged(whole, violations, start, base, tolerance, structure.unconstrained, stop)
        if duals.accurate and violations.worst < tol.FINE_VIOLATION:
            weights[i, duals.indices], found[i] = duals.sign * duals.weights, True
            active = duals.weights > 0
            index = duals.indices[active]
            rows = Rows(whole.t[index], whole.f[index], duals.sign[active], duals.weights[active])
        else:
            failed(i)
    return weights, found, rows


class _Recovery:
    """Signals and multipliers of all problems, in the units of the method, time or bins last."""

    def __init__(self, structure: Structure, model: EndsModel, p: Array, step: Array, weights: Array):
        self._structure, self._lti, border = structure, model.lti, structure.border
        lti, (n, T) = self._lti, (self._lti.state_dim, self._lti.horizon)
        self._theta, self._equations = np.split(step, [border.size], axis=1)
        self._on_rows = self._row_multipliers(model, weights)
        pulses = self._on_rows[:, :, :T].copy()
        pulses[:, border.point_f[:n], border.point_t[:n]] += self._equations[:, :n]
        force = fft.rfft(pulses)
        spectrum = self._spectrum(model.spectra(p), force)
        self._y = fft.irfft(spectrum, T)
        self._last = np.zeros((len(p), n))
        self._last[:, ~np.isnan(lti.end)] = p[:, 1 + n :]
        self._last[:, border.free_end] = self._theta[:, border.at_end]
        gradient = lti.M @ spectrum + force
        if model.linear is not None:
            gradient += model.linear
        eta_hat = self._adjoint(gradient)
        self._band = (np.einsum("ja,Njk->Nak", lti.B, eta_hat) - gradient[:, n:]) * ~lti.passed
        self._eta = fft.irfft(eta_hat, T)
        self._set_ends()

    def _row_multipliers(self, model: EndsModel, weights: Array) -> Array:
        """Return the multipliers of F y_t at t < T and of x_T, (N, rows, T+1)."""
        lti, border, whole, n = self._lti, self._structure.border, model.whole, self._lti.state_dim
        on_rows = np.zeros((len(weights), len(lti.F), lti.horizon + 1))
        on_rows[:, whole.rows, :-1] = weights[:, :-n].reshape(len(weights), -1, lti.horizon)
        on_rows[:, :n, -1] = weights[:, -n:]
        fixed = slice(n, len(border.point_t))
        on_rows[:, border.point_f[fixed], border.point_t[fixed]] += self._equations[:, fixed]
        return on_rows

    def _spectrum(self, base: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Return the spectrum of y, (N, n+m, bins)."""
        spaces, border = self._structure.spaces, self._structure.border
        v = np.einsum("iak,Nik->Nak", spaces.N.conj(), force)
        spectrum = base - np.einsum("iak,Nak->Nik", spaces.N, v)
        theta, ends = self._theta, border.ends_count
        spectrum += np.einsum("Na,iak->Nik", theta[:, :ends], border.end_responses)
        for q, k in enumerate(border.bins):
            spectrum[:, :, k] += (border.amplitude[q] * theta[:, ends + q])[:, None] * border.vectors[:, q]
        return spectrum

    def _adjoint(self, gradient: ComplexArray) -> ComplexArray:
        """Return the spectrum of eta, (N, n, bins)."""
        border, spaces = self._structure.border, self._structure.spaces
        eta = np.einsum("ijk,Njk->Nik", spaces.adjoint_map, gradient)
        row = len(border.point_t)
        for scale, singular in zip(border.singular_scale, spaces.singular, strict=True):
            weight = int(spaces.weight[singular.k])
            value = self._equations[:, row] + (1j * self._equations[:, row + 1] if weight == 2 else 0.0)
            eta[:, :, singular.k] += (scale * self._lti.horizon / weight) * value[:, None] * singular.left
            row += weight
        return eta

    def _set_ends(self) -> None:
        """Set mu_0, mu_T where ends are fixed by transversality."""
        lti, n = self._lti, self._lti.state_dim
        first = self._y[:, :, 0] @ lti.M[:n].T + (0.0 if lti.linear is None else lti.linear[:n, 0])
        last = self._last @ lti.P + lti.p
        start, end = np.flatnonzero(~np.isnan(lti.start)), np.flatnonzero(~np.isnan(lti.end))
        self._on_rows[:, start, 0] = (self._eta[:, :, 0] @ lti.A - first)[:, start]
        self._on_rows[:, end, -1] = (-self._eta[:, :, -1] - last)[:, end]

    def in_units(self, units: Units, found: Mask, rows: Rows | None) -> Together:
        """Return everything in the user's units, time before components."""
        n, bins = self._lti.state_dim, self._structure.spaces.weight / self._lti.horizon
        x, u = units.cost / units.x, units.cost / units.u
        states = np.concatenate([self._y[:, :n], self._last[:, :, None]], axis=2)
        return Together(
            states.swapaxes(1, 2) * units.x,
            self._y[:, n:].swapaxes(1, 2) * units.u,
            self._eta.swapaxes(1, 2) * x,
            self._on_rows[:, :n].swapaxes(1, 2) * x,
            self._on_rows[:, n:, :-1].swapaxes(1, 2) * u,
            (self._band * bins).swapaxes(1, 2) * u,
            found,
            rows,
        )

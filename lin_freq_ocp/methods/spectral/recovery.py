"""The multipliers of the maximum principle from the final spectra, and their residuals (docs/spectral.md, 8 and 9).

With the spectrum p_k of M y + h + forces, the adjoint is eta_k = -(zI - A)^{-*} p_k at every bin; near eigenvalues its
part along small singular values is the multiplier of that bin's compatibility equation. A recursion would multiply
rounding by the growth of the dynamics, 3e46 on the pendulum sampled at 0.1 s.

A batch of initial states has the same formulas, with the problems as the first axis. It is not measured: its callers
certify the answers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, sealed
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.exchange import ExchangeOutcome
from lin_freq_ocp.methods.spectral.kkt import BorderedSystem
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.reductions import soft_sets
from lin_freq_ocp.methods.spectral.rows import Rows
from lin_freq_ocp.methods.spectral.structure import Data, EndsModel, Structure, forces
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.linked_ends import Periodic
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Residuals
from lin_freq_ocp.program.stop_band_rows import bin_multipliers

BLOCK = 1 << 17  # times of which residuals are computed at once


def trajectory(outcome: ExchangeOutcome, units: LtiUnits) -> Trajectory:
    """Return the point in the user's units."""
    n, at = len(units.x), outcome.signals
    x = np.empty((at.y.shape[1] + 1, n))
    np.multiply(at.y[:n].T, units.x, out=x[:-1])
    x[-1] = at.last * units.x
    return Trajectory(sealed(x), sealed(at.y[n:].T * units.u))


@dataclass(frozen=True, eq=False)
class Recovered:
    """Multipliers in the units of the Lti problem, time or bins last."""

    eta_C: float
    eta: Array  # (n, T)
    on_rows: Array  # of F y_t, (rows, T+1): the states' mu, the controls' nu, the stage rows'; at T of x_T
    band: ComplexArray  # spectrum of the stop bands' forces R'rho_u, (m, bins); zero at passed bins
    stationarity: float  # stationarity residual: largest amplitude of B'eta - (gradient in u) at passed bins
    rho_x: ComplexArray  # ((T+1)//2 + 1, n)


def recover(structure: Structure, data: Data, outcome: ExchangeOutcome, spectrum: ComplexArray) -> Recovered:
    """Return the multipliers of an outcome with the spectrum of y; of its ray (eta_C = 0) if it has one."""
    lti, ray, n = data.lti, outcome.ray, data.lti.state_dim
    if ray is None:
        working, y, eta_C = outcome.working, outcome.multipliers, 1.0
        gradient = lti.M @ spectrum
        gradient += forces(structure, lti, y, working)[0]
        if data.linear is not None:
            gradient += data.linear
    else:
        working, y, eta_C = ray.working, ray.multipliers, 0.0
        gradient, _ = forces(structure, lti, y, working)
    eta_hat = _adjoint_spectrum(structure, y, gradient)
    if lti.response is None:
        through_controls = lti.B.T @ eta_hat
    else:
        through_controls = np.einsum("imk,ik->mk", lti.response.conj(), eta_hat)
    band = through_controls - gradient[n:]
    stationarity = float(np.abs(band[lti.passed]).max(initial=0.0)) / lti.horizon
    band[lti.passed] = 0.0
    eta, kkt = fft.irfft(eta_hat, lti.horizon), structure.kkt
    on_rows, fixed = np.zeros((len(lti.F), lti.horizon + 1)), slice(lti.start_points, len(kkt.point_t))
    np.add.at(on_rows, (working.f, working.t), working.sign * working.weights)
    np.add.at(on_rows, (kkt.point_f[fixed], kkt.point_t[fixed]), y[fixed])
    on_bands, rho_x = y[len(y) - len(kkt.bands) :], np.zeros(lti.state_stop.shape, dtype=np.complex128)
    for i in kkt.band_components:
        rho_x[:, i] = bin_multipliers(lti.state_samples, lti.state_stop[:, i], on_bands[kkt.band_component == i])
    found = Recovered(eta_C, eta, on_rows, band, stationarity, rho_x)
    _set_ends(kkt, lti, outcome, found, on_bands)
    return found


def _adjoint_spectrum(structure: Structure, y: Array, gradient: ComplexArray) -> ComplexArray:
    """Return the spectrum of eta, (n, bins)."""
    spaces, kkt, n = structure.spaces, structure.kkt, structure.kkt.lti.state_dim
    with np.errstate(all="ignore"):
        eta = -spaces.resolvent.apply_adjoint(spaces.z, gradient[:n])
    eta[:, spaces.near.k] = -spaces.near.adjoint(gradient[:, spaces.near.k])
    row = len(kkt.point_t)
    for scale, singular in zip(kkt.singular_scale, spaces.singular, strict=True):
        weight = spaces.weight[singular.k]
        value = y[row] if weight == 1 else y[row] + 1j * y[row + 1]
        eta[:, singular.k] += singular.left * (scale * kkt.lti.horizon / weight * value)
        row += int(weight)
    return eta


def _set_ends(kkt: BorderedSystem, lti: Lti, outcome: ExchangeOutcome, found: Recovered, on_bands: Array) -> None:
    """Set mu_0, mu_T where ends are fixed by transversality: any vector is normal there."""
    n, at, eta, on_rows = lti.state_dim, outcome.signals, found.eta, found.on_rows
    first, last = np.zeros(n), np.zeros(n)
    np.add.at(first, kkt.band_component, on_bands * kkt.bands[:, 0])
    np.add.at(last, kkt.band_component, on_bands * kkt.bands[:, -1])
    first += lti.F[len(lti.M) :, :n].T @ on_rows[len(lti.M) :, 0]
    if found.eta_C:
        first += lti.M[:n] @ at.y[:, 0] + (0.0 if lti.linear is None else lti.linear[:n, 0])
        last += lti.P @ at.last + lti.p
    start, end = np.flatnonzero(~np.isnan(lti.start)), np.flatnonzero(~np.isnan(lti.end))
    on_rows[start, 0] = (lti.A.T @ eta[:, 0] - first)[start]
    on_rows[end, -1] = (-eta[:, -1] - last)[end]


def residuals(lti: Lti, outcome: ExchangeOutcome, found: Recovered) -> Residuals:
    """Return the residuals of the maximum principle, each relative to the size of its own terms.

    primal: dynamics, ends, bands, bounds. dual: adjoint equation, transversality, stationarity in u. gap: multipliers
    times slacks, and dual residuals times the trajectory.
    """
    y, last, n = outcome.signals.y, outcome.signals.last, lti.state_dim
    stopped = ~lti.passed
    band = np.abs(fft.rfft(y[n:])[stopped]).max(initial=0.0) if stopped.any() else 0.0
    energy = max(float(np.linalg.norm(y[n:])), tol.LEAST_SIZE)
    missed = max(_missed_values(lti, y, last), outcome.violation, 0.0)
    adjoint, terms, product = _adjoint(lti, outcome, found)
    gains = np.abs(lti.B) if lti.response is None else np.abs(lti.response).max(2)
    through_u = float(gains.sum(0).max()) * terms
    working = outcome.working
    slack = working.limits(lti) - working.values(y, last)
    missing = np.where(working.saturated(lti), np.maximum(slack, 0.0), np.abs(slack))
    complementarity = float(working.weights @ missing)
    gap = complementarity + product + float(found.stationarity * np.abs(y[n:]).sum())
    return Residuals(
        primal=max(_missed_steps(lti, y, last), float(band) / energy, missed),
        dual=max(adjoint / terms, found.stationarity / max(through_u, tol.LEAST_SIZE * lti.curvature_unit)),
        gap=gap / max(lti.cost_level, abs(outcome.cost)),
    )


def _missed_steps(lti: Lti, y: Array, last: Array) -> float:
    """Return the largest residual of the dynamics, relative to the states."""
    n, T, largest, size = lti.state_dim, lti.horizon, 0.0, max(float(np.abs(last).max()), tol.LEAST_SIZE)
    if lti.response is not None:
        residual = fft.irfft(np.einsum("imk,mk->ik", lti.response, fft.rfft(y[n:])), T) - np.roll(y[:n], -1, axis=1)
        residual += 0.0 if lti.offset is None else lti.offset
        return float(np.abs(residual).max()) / max(size, float(np.abs(y[:n]).max()))
    dynamics = np.hstack([lti.A, lti.B])
    for start in range(0, T, BLOCK):
        stop = min(start + BLOCK, T)
        residual = dynamics @ y[:, start:stop]
        residual -= _columns(y[:n], last, start + 1, stop + 1)
        if lti.offset is not None:
            residual += lti.offset[:, start:stop]
        largest = max(largest, float(np.abs(residual, out=residual).max()))
        size = max(size, float(np.abs(y[:n, start:stop]).max()))
    return largest / size


def _missed_values(lti: Lti, y: Array, last: Array) -> float:
    """Return the errors of x_0, fixed values and stopped bins of states, relative to the signals."""
    n, size = lti.state_dim, max(-float(y.min()), float(y.max()), tol.LEAST_SIZE)
    t, f = lti.fixed_points
    start = np.where(np.isnan(lti.start), 0.0, lti.start - y[:n, 0])
    missed = max(float(np.abs(start).max()), float(np.abs(y[f, t] - lti.bounds.lower[f, t]).max(initial=0.0))) / size
    if not lti.state_stop.any():
        return missed
    x = np.hstack([y[:n], last[:, None]])[:, : lti.state_samples]
    spectrum = np.abs(fft.rfft(x)).T[lti.state_stop].max()
    return max(missed, float(spectrum) / max(float(np.linalg.norm(x)), tol.LEAST_SIZE))


def _adjoint(lti: Lti, outcome: ExchangeOutcome, found: Recovered) -> tuple[float, float, float]:
    """Return the largest residual of the adjoint equation, the size of its terms, and <|residuals|, |x|>.

    The residuals are eta_{t-1} - A'eta_t + Q x + S u + q + mu + C'l + (R'rho), (n, T+1).
    """
    at, n, T = outcome.signals, lti.state_dim, lti.horizon
    largest, product, sizes = 0.0, 0.0, np.zeros(0)
    for start in range(0, T + 1, BLOCK):
        stop = min(start + BLOCK, T + 1)
        terms = list(_adjoint_terms(lti, outcome, found, start, stop))
        size = np.array([float(np.abs(term).max()) for term in terms])
        sizes = size if start == 0 else np.maximum(sizes, size)
        residual = np.abs(sum(terms[1:], start=terms[0]))
        largest = max(largest, float(residual.max()))
        product += float(np.einsum("it,it->", residual, np.abs(_columns(at.y[:n], at.last, start, stop))))
    return largest, max(float(sizes.sum()), tol.LEAST_SIZE * lti.curvature_unit), product


def _adjoint_terms(lti: Lti, outcome: ExchangeOutcome, found: Recovered, start: int, stop: int) -> Iterator[Array]:
    """Yield the terms at start <= t < stop, (n, stop - start); at T, the gradient is that of the terminal cost."""
    at, n, eta, eta_C, zero = outcome.signals, lti.state_dim, found.eta, found.eta_C, np.zeros(lti.state_dim)
    yield found.on_rows[:n, start:stop]
    before = np.array(eta[:, np.arange(start - 1, stop - 1)])  # at t = 0, that of the end, if it is periodic
    if start == 0 and not lti.periodic:
        before[:, 0] = 0.0
    if stop == lti.horizon + 1 and lti.periodic:
        before[:, -1] = 0.0
    yield before
    yield _columns(-lti.A.T @ eta[:, start:stop], zero, 0, stop - start)
    if eta_C and (lti.state_cost or lti.P.any()):
        yield _columns(lti.M[:n] @ at.y[:, start:stop], lti.P @ at.last, 0, stop - start)
    if eta_C and (lti.linear is not None or lti.p.any()):
        yield _columns(np.zeros((n, lti.horizon)) if lti.linear is None else lti.linear[:n], lti.p, start, stop)
    if len(lti.F) > len(lti.M):
        yield lti.F[len(lti.M) :, :n].T @ found.on_rows[len(lti.M) :, start:stop]
    if found.rho_x.any():
        yield _columns(time_signal(found.rho_x, lti.state_samples).T, np.zeros(n), start, stop)


def _columns(inner: Array, last: Array, start: int, stop: int) -> Array:
    """Return columns start .. stop - 1 of [inner, last]."""
    some = inner[:, start:stop]
    return some if some.shape[1] == stop - start else np.hstack([some, last[:, None]])


def in_units(problem: OptimalControlProblem, structure: Structure, units: LtiUnits, found: Recovered) -> Multipliers:
    """Return the theorem's multipliers in the user's units."""
    n, m = problem.state_dim, problem.control_dim
    x, u = units.cost / units.x, units.cost / units.u
    forces = found.on_rows[: n + m].T * np.concatenate([x, u])
    on_sets = {one.name: one.multipliers(forces, found.eta_C) for one in soft_sets(problem) or ()}
    on_ends: dict[str, Array] = {}
    if structure.kkt.lti.periodic:  # the multiplier of x_T - x_0 = 0; mu_0 moves to mu_T where x_T has the bound
        tube, mu = problem.state_tube, forces[:, :n]
        at_end = np.where(mu[0] > 0, tube.upper[-1] < tube.upper[0], tube.lower[-1] > tube.lower[0])
        mu[-1] = np.where(at_end, mu[0], 0.0)
        mu[0] -= mu[-1]
        on_ends[Periodic.name] = sealed((-(found.eta[:, -1] * x) - mu[-1])[None])
    weights = found.on_rows[n + m :, :-1] * (units.cost / units.rows)[:, None]
    splits = np.cumsum([rows.e.shape[-1] for rows in problem.stage_rows])[:-1]
    on_stage_rows = np.split(weights, splits) if problem.stage_rows else []
    return Multipliers(
        found.eta_C,
        sealed(found.eta.T * x),
        sealed(forces[:, :n]),
        sealed(forces[:-1, n:]),
        (found.band * (structure.spaces.weight / problem.horizon)).T * u,
        found.rho_x * x,
        {rows.name: part.T for rows, part in zip(problem.stage_rows, on_stage_rows, strict=True)} | on_sets | on_ends,
    )


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


class BatchRecovery:
    """Signals and multipliers of a batch of initial states, in the units of the method, time or bins last.

    ``p`` (N, 1 + count) are the parameters of the model, ``step`` (N, size + equations) the bordering unknowns and the
    multipliers of the equations, ``weights`` (N, values) the multipliers of all bounded values, with signs.
    """

    def __init__(self, structure: Structure, model: EndsModel, p: Array, step: Array, weights: Array):
        self._structure, self._lti, kkt = structure, model.lti, structure.kkt
        lti, (n, T) = self._lti, (self._lti.state_dim, self._lti.horizon)
        self._theta, self._equations = np.split(step, [kkt.size], axis=1)
        whole, fixed = model.whole, slice(n, len(kkt.point_t))
        self._on_rows = np.zeros((len(weights), len(lti.F), T + 1))
        self._on_rows[:, whole.rows, :-1] = weights[:, :-n].reshape(len(weights), -1, T)
        self._on_rows[:, :n, -1] = weights[:, -n:]
        self._on_rows[:, kkt.point_f[fixed], kkt.point_t[fixed]] += self._equations[:, fixed]
        pulses = self._on_rows[:, :, :T].copy()
        pulses[:, kkt.point_f[:n], kkt.point_t[:n]] += self._equations[:, :n]
        force = fft.rfft(pulses)
        spectrum = self._spectrum(model.spectra(p), force)
        self._y = fft.irfft(spectrum, T)
        self._last = np.zeros((len(p), n))
        self._last[:, ~np.isnan(lti.end)] = p[:, 1 + n :]
        self._last[:, kkt.free_end] = self._theta[:, kkt.at_end]
        gradient = lti.M @ spectrum + force
        if model.linear is not None:
            gradient += model.linear
        eta_hat = self._adjoint(gradient)
        self._band = (np.einsum("ja,Njk->Nak", lti.B, eta_hat) - gradient[:, n:]) * ~lti.passed
        self._eta = fft.irfft(eta_hat, T)
        # mu_0, mu_T where ends are fixed by transversality
        first = self._y[:, :, 0] @ lti.M[:n].T + (0.0 if lti.linear is None else lti.linear[:n, 0])
        last = self._last @ lti.P + lti.p
        start, end = np.flatnonzero(~np.isnan(lti.start)), np.flatnonzero(~np.isnan(lti.end))
        self._on_rows[:, start, 0] = (self._eta[:, :, 0] @ lti.A - first)[:, start]
        self._on_rows[:, end, -1] = (-self._eta[:, :, -1] - last)[:, end]

    def _spectrum(self, base: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Return the spectrum of y, (N, n+m, bins)."""
        spaces, kkt = self._structure.spaces, self._structure.kkt
        v = np.einsum("iak,Nik->Nak", spaces.N.conj(), force)
        spectrum = base - np.einsum("iak,Nak->Nik", spaces.N, v)
        theta, ends = self._theta, kkt.ends_count
        spectrum += np.einsum("Na,iak->Nik", theta[:, :ends], kkt.end_responses)
        for q, k in enumerate(kkt.bins):
            spectrum[:, :, k] += (kkt.amplitude[q] * theta[:, ends + q])[:, None] * kkt.vectors[:, q]
        return spectrum

    def _adjoint(self, gradient: ComplexArray) -> ComplexArray:
        """Return the spectrum of eta, (N, n, bins)."""
        kkt, spaces = self._structure.kkt, self._structure.spaces
        eta = np.einsum("ijk,Njk->Nik", spaces.adjoint_map, gradient)
        row = len(kkt.point_t)
        for scale, singular in zip(kkt.singular_scale, spaces.singular, strict=True):
            weight = int(spaces.weight[singular.k])
            value = self._equations[:, row] + (1j * self._equations[:, row + 1] if weight == 2 else 0.0)
            eta[:, :, singular.k] += (scale * self._lti.horizon / weight) * value[:, None] * singular.left
            row += weight
        return eta

    def in_units(self, units: LtiUnits, found: Mask, rows: Rows | None) -> Together:
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

"""Residuals of the maximum principle, from the data in the time domain."""

from __future__ import annotations

import numpy as np
from scipy import fft

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.algorithm.exchange import Outcome
from lin_freq_ocp.methods.spectral.algorithm.recovery import Recovered
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.transcription.program import Residuals


def residuals(lti: Lti, outcome: Outcome, found: Recovered) -> Residuals:
    """Return the residuals of the maximum principle, each relative to the size of its own terms.

    primal: dynamics, ends, bands, bounds. dual: adjoint equation, transversality, stationarity in u. gap: multipliers
    times slacks, and dual residuals times the trajectory.
    """
    y, last, n = outcome.signals.y, outcome.signals.last, lti.state_dim
    x = np.hstack([y[:n], last[:, None]])
    dynamics = x[:, 1:] - lti.A @ y[:n] - lti.B @ y[n:]
    if lti.offset is not None:
        dynamics -= lti.offset
    size = max(float(np.abs(x).max()), tol.LEAST_SIZE)
    stopped = ~lti.passed
    band = np.abs(fft.rfft(y[n:])[stopped]).max(initial=0.0) if stopped.any() else 0.0
    energy = max(float(np.linalg.norm(y[n:])), tol.LEAST_SIZE)
    missed = max(_missed_values(lti, y, x), outcome.violation, 0.0)
    adjoint, terms = _adjoint(lti, outcome, found)
    through_u = float(np.abs(lti.B).sum(0).max()) * terms
    gap = _complementarity(outcome, lti) + float(np.abs(adjoint * x).sum() + found.stationarity * np.abs(y[n:]).sum())
    return Residuals(
        primal=max(float(np.abs(dynamics).max()) / size, float(band) / energy, missed),
        dual=max(
            float(np.abs(adjoint).max()) / terms,
            found.stationarity / max(through_u, tol.LEAST_SIZE * lti.curvature_unit),
        ),
        gap=gap / max(lti.cost_level, abs(outcome.cost)),
    )


def _missed_values(lti: Lti, y: Array, x: Array) -> float:
    """Return the errors of x_0, fixed values and stopped bins of states, relative to the signals."""
    size = max(float(np.abs(y).max()), tol.LEAST_SIZE)
    t, f = lti.fixed_points
    start = np.where(np.isnan(lti.start), 0.0, lti.start - x[:, 0])
    missed = max(float(np.abs(start).max()), float(np.abs(y[f, t] - lti.lower[f, t]).max(initial=0.0))) / size
    if not lti.state_stop.any():
        return missed
    spectrum = np.abs(fft.rfft(x)).T[lti.state_stop].max()
    return max(missed, float(spectrum) / max(float(np.linalg.norm(x)), tol.LEAST_SIZE))


def _adjoint(lti: Lti, outcome: Outcome, found: Recovered) -> tuple[Array, float]:
    """Return eta_{t-1} - A'eta_t + Q x + S u + q + mu + C'l + (R'rho), (n, T+1), and the size of its terms.

    eta_{-1} and eta_T are 0; at T the gradient is that of the terminal cost.
    """
    at, n, eta, eta_C = outcome.signals, lti.state_dim, found.eta, found.eta_C
    end = np.zeros((n, 1))
    terms = [
        np.hstack([end, eta]),
        np.hstack([-lti.A.T @ eta, end]),
        eta_C * np.hstack([lti.M[:n] @ at.y, (lti.P @ at.last)[:, None]]),
        found.on_rows[:n],
    ]
    if lti.linear is not None or lti.p.any():
        linear = np.zeros((n, lti.horizon)) if lti.linear is None else lti.linear[:n]
        terms.append(eta_C * np.hstack([linear, lti.p[:, None]]))
    if len(lti.F) > len(lti.M):
        terms.append(lti.F[len(lti.M) :, :n].T @ found.on_rows[len(lti.M) :])
    if found.rho_x.any():
        terms.append(time_signal(found.rho_x, lti.horizon + 1).T)
    size = sum(float(np.abs(term).max()) for term in terms)
    return sum(terms[1:], start=terms[0]), max(size, tol.LEAST_SIZE * lti.curvature_unit)


def _complementarity(outcome: Outcome, lti: Lti) -> float:
    """Return <l, |slack|> of the working rows."""
    working, at = outcome.working, outcome.signals
    return float(working.weights @ np.abs(working.limits(lti) - working.values(at.y, at.last)))

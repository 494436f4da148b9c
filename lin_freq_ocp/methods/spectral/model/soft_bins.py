"""Soft stop bands by exact penalties: where the price of a bin exceeds its multiplier, the bin is zero.

Derivation: docs/spectral.md, 12.

A bound of zero with a price w costs w |uhat_k|, whose subgradients at uhat_k = 0 are all lambda with |lambda| <= w.
With these bins removed, rho_k is such a subgradient if |rho_k| <= w: then nothing is gained by opening them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, sealed
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import stop_band
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.terms.maps import SpectrumForm
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.problem.trajectory import Multipliers

PRICE_ROUNDING = 1e-9  # part of a price, and of other forces on the component in a ray, that may be rounding
FIELDS = {TermKind.CONTROL_SPECTRUM: "control_spectrum", TermKind.STATE_SPECTRUM: "state_spectrum"}


@dataclass(frozen=True, eq=False)
class SoftBins:
    """A given problem, the same with its soft bins removed from the spectra, and the terms that these were."""

    given: OptimalControlProblem
    problem: OptimalControlProblem
    terms: tuple[Term, ...]

    def multipliers(self, found: Multipliers) -> Multipliers:
        """Return multipliers of the given problem; UnsupportedError if one exceeds its price, which counts eta_C times.

        Bins that are removed by a band of the given problem, too, keep theirs there.
        """
        through_u = self.given.equations.pull_back(found.eta)[1]
        rho = {
            TermKind.CONTROL_SPECTRUM: (found.rho_u.copy(), self.given.control_stop, through_u),
            TermKind.STATE_SPECTRUM: (found.rho_x.copy(), self.given.state_stop, found.eta),
        }
        stage = dict(found.stage)
        for term in self.terms:
            bins, component, (forces, stopped, others) = term.map.nearest_bins, term.map.component, rho[term.kind]
            own = np.where(stopped[bins, component], 0.0, forces[bins, component])
            price = found.eta_C * np.broadcast_to(term.penalty.weights, (len(bins), 1))[:, 0]
            rounding = 0.0 if found.eta_C else np.abs(others[:, component]).max()
            if (np.abs(own) > price + PRICE_ROUNDING * (price + rounding)).any():
                raise UnsupportedError(
                    f"method 'spectral': {term.name}: a soft bin is not zero at its price; the Fourier-domain method "
                    "takes soft bins whose price keeps them zero. Use method 'structured'."
                )
            forces[bins, component] -= own
            stage[term.name] = _pairs(own if found.eta_C else np.zeros_like(own))
        rho_u, rho_x = (sealed(forces) for forces, *_ in rho.values())
        return Multipliers(found.eta_C, found.eta, found.mu, found.nu, rho_u, rho_x, stage)


def soft_bins(problem: OptimalControlProblem) -> SoftBins:
    """Return the problem with its soft bins removed; unchanged if it has none."""
    terms = tuple(term for term in problem.terms if _is_soft_band(problem, term))
    changes: dict[str, object] = {}
    for kind, field in FIELDS.items():
        mine = [term for term in terms if term.kind == kind]
        if mine:
            replaced = {term.source[1] for term in mine if term.source is not None}
            kept = [one for i, one in enumerate(entries_of(getattr(problem, field))) if i not in replaced]
            bands = [stop_band(bins=term.map.nearest_bins, component=term.map.component) for term in mine]
            changes[field] = [*kept, *bands]
    return SoftBins(problem, replace(problem, **changes) if changes else problem, terms)


def _is_soft_band(problem: OptimalControlProblem, term: Term) -> bool:
    """Whether a term is the price of plain DFT bins of a single component, bin by bin."""
    if term.kind not in FIELDS or term.hard:
        return False
    form = term.map.spectrum_form(problem.state_dim, problem.control_dim)
    return form is not None and term.shape == (len(form.bins), 2) and _plain(form) and not term.penalty.sizes().any()


def _plain(form: SpectrumForm) -> bool:
    return (
        form.points == len(form.window)
        and bool((form.window == 1).all())
        and bool((form.row[form.row != 0] == 1).all())
    )


def _pairs(values: ComplexArray) -> Array:
    """Return (Re, Im) of values (bins,), (bins, 2)."""
    return sealed(np.stack([values.real, values.imag], axis=1))

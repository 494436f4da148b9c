"""Derivatives of the optimal cost by the data of a problem, from its multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import html_table, shape_and_range
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.transform.reformulations import at_frequencies


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of the optimal cost J*, in the units of the problem; one-sided where the active bounds change.

    If the multipliers are not unique, each is one of several, and the cost of a change lies between these.

    Attributes
    ----------
    initial_state, terminal_state : (n,)
        dJ*/dx_0 and dJ*/dx_T where these are fixed, NaN elsewhere.
    state_upper, state_lower : (T+1, n)
        By the bounds of x_t: at most 0 for an upper bound, at least 0 for a lower one; 0 where a bound is inactive or
        absent. The derivatives by fixed values are in the two fields above.
    control_upper, control_lower : (T, m)
    stage_rows : mapping from name to (T, rows)
        By the limits e_t.
    limits : mapping from name to (groups, dim) or (groups, 1)
        By the limits of all other terms: of the rows of a set; of the radius of a ball, the limit of a mask at each of
        its bins in the unit in which it is stated (of a density and an energy its root, of db relative to the
        reference).
    offset : (T, n)
        By the offset d_t of the dynamics: the price of a disturbance at time t.
    control_bins : complex (T//2 + 1, m), state_bins : complex ((T+1)//2 + 1, n)
        Prices of removed bins, 0 at free ones: if a bin and its conjugate become z and conj(z) instead of 0, J* grows
        by Re(conj(price) z).

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.sensitivities.terminal_state.shape
    (2,)
    """

    initial_state: Array
    terminal_state: Array
    state_upper: Array
    state_lower: Array
    control_upper: Array
    control_lower: Array
    stage_rows: Mapping[str, Array]
    limits: Mapping[str, Array]
    offset: Array
    control_bins: ComplexArray
    state_bins: ComplexArray

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return the shape and the extremes of every array under its name."""
        arrays = dict[str, Array | ComplexArray]()
        for name, value in vars(self).items():
            arrays |= (
                {f"{name}: {key}": entry for key, entry in value.items()}
                if isinstance(value, Mapping)
                else {name: value}
            )
        return [(name, shape_and_range(values)) for name, values in arrays.items()]

    def __repr__(self) -> str:
        return f"Sensitivities({', '.join(f'{name} {text}' for name, text in self.rows)})"

    def _repr_html_(self) -> str:
        return html_table("Derivatives of the optimal cost", self.rows)


def sensitivities_of(problem: OptimalControlProblem, multipliers: Multipliers) -> Sensitivities:
    """Return the derivatives of the optimal cost by the data, from the multipliers of an optimum.

    Parameters
    ----------
    problem : OptimalControlProblem
    multipliers : Multipliers
        Normal ones: eta_C = 1.

    Raises
    ------
    UnsupportedError
        If the multipliers are abnormal (eta_C = 0): then they are not prices.

    Notes
    -----
    By the Lagrangian of the maximum principle: dJ*/dupper = -mu where mu > 0, dJ*/dlower = -mu where mu < 0,
    dJ*/dx_0 = -mu_0, dJ*/dd_t = -eta_t, dJ*/d(bin k) = -rho_k.
    """
    if multipliers.eta_C != 1:
        raise UnsupportedError(
            f"sensitivities: got eta_C = {multipliers.eta_C:g}; only normal multipliers have prices."
        )
    problem = at_frequencies(problem, multipliers.frequencies)
    fixed = problem.state_tube.fixed
    ends = [np.where(fixed[t], -multipliers.mu[t], np.nan) for t in (0, -1)]
    mu, nu = np.where(fixed, 0.0, multipliers.mu), multipliers.nu
    return Sensitivities(
        initial_state=ends[0],
        terminal_state=ends[1],
        state_upper=-np.maximum(mu, 0.0),
        state_lower=-np.minimum(mu, 0.0),
        control_upper=-np.maximum(nu, 0.0),
        control_lower=-np.minimum(nu, 0.0),
        stage_rows={rows.name: -multipliers.stage[rows.name] for rows in problem.stage_rows},
        limits={
            term.name: -np.asarray(term.per_limit)[..., None] * prices
            for term in problem.terms
            if not (term.kind.is_rows or term.kind.is_cost)
            if (prices := term.penalty.limit_multipliers(multipliers.stage[term.name])) is not None
        },
        offset=-multipliers.eta,
        control_bins=-multipliers.rho_u,
        state_bins=-multipliers.rho_x,
    )


def bin_prices(problem: OptimalControlProblem, multipliers: Multipliers) -> tuple[Array, Array]:
    """Return the prices of a larger limit at each bin, (T//2 + 1, m) for controls, ((T+1)//2 + 1, n) for states.

    -dJ*/dlimit: |rho| of removed bins, and |lambda| of masks and energies. Points between bins count at the nearest.
    """
    prices = np.abs(multipliers.rho_u), np.abs(multipliers.rho_x)
    for term in at_frequencies(problem, multipliers.frequencies).terms:
        weights, spectrum = multipliers.stage.get(term.name), term.map.spectrum
        if weights is None or spectrum is None or term.kind.of == "outputs":
            continue
        size = term.per_limit * np.linalg.norm(spectrum.pairs(weights), axis=1)
        of_component = prices[term.kind.of == "states"][:, spectrum.component]
        np.add.at(of_component, spectrum.nearest_bins, size)
    return prices

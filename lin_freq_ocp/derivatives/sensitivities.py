"""Derivatives of the optimal cost by the data of a problem, from its optimum and multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, assign
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import html_table, shape_and_range
from lin_freq_ocp.derivatives.data import Variables, slopes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reformulations import at_frequencies


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of the optimal cost J*, in the units of the problem; one-sided where the active bounds change.

    If the multipliers are not unique, each is one of several, and the cost of a change lies between these.

    Attributes
    ----------
    initial_state, terminal_state : (n,)
        By the values of the ends where these are fixed; by a move of their bounds where these are tighter than those of
        the state set; NaN elsewhere.
    state_upper, state_lower : (T+1, n)
        By the bounds of the state set: at most 0 for an upper bound, at least 0 for a lower one; 0 where a bound is
        inactive or absent, and where the bounds of an end are tighter.
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
    Q, R, S, P, q, r, p, x_ref, u_ref
        By the quadratic cost, in the shapes of its fields: what is constant in time has the sum over time.
    A, B : as in the dynamics, or None
        Of linear dynamics; likewise.
    response : complex (N//2 + 1, p, m), or None
        By G of a FrequencyResponse: a change d of G_k adds Re(conj(response_k) d).
    C, D : mapping from name to array
        By the matrices of joint rows, in their shapes.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.sensitivities.terminal_state.shape, result.sensitivities.A.shape
    ((2,), (2, 2))
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
    Q: Array
    R: Array
    S: Array
    P: Array
    q: Array
    r: Array
    p: Array
    x_ref: Array
    u_ref: Array
    A: Array | None
    B: Array | None
    response: ComplexArray | None
    C: Mapping[str, Array]
    D: Mapping[str, Array]

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return the shape and the extremes of every array under its name."""
        arrays = dict[str, Array | ComplexArray]()
        for name, value in vars(self).items():
            if isinstance(value, Mapping):
                arrays |= {f"{name}: {key}": entry for key, entry in value.items()}
            elif value is not None:
                arrays[name] = value
        return [(name, shape_and_range(values)) for name, values in arrays.items()]

    def __repr__(self) -> str:
        return f"Sensitivities({', '.join(f'{name} {text}' for name, text in self.rows)})"

    def _repr_html_(self) -> str:
        return html_table("Derivatives of the optimal cost", self.rows)


def sensitivities_of(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Sensitivities:
    """Return the derivatives of the optimal cost by the data, the slopes of the Lagrangian at an optimum.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory
    multipliers : Multipliers
        Normal ones: eta_C = 1.

    Raises
    ------
    UnsupportedError
        If the multipliers are abnormal (eta_C = 0): then they are not prices.
    """
    if multipliers.eta_C != 1:
        text = f"sensitivities: got eta_C = {multipliers.eta_C:g}; only normal multipliers have prices."
        raise UnsupportedError(text)
    problem = at_frequencies(problem, multipliers.frequencies)
    found = slopes(problem, Variables.at(problem, trajectory, multipliers))
    rows = [one.name for one in problem.stage_rows]
    families = {
        "stage_rows": {name: found.pop(name) for name in rows},
        "limits": {term.name: found.pop(term.name) for term in problem.terms if term.name in found},
        **{part: {name: found.pop(f"{name}.{part}") for name in rows if f"{name}.{part}" in found} for part in "CD"},
    }
    prices = object.__new__(Sensitivities)
    assign(prices, **{**dict.fromkeys(("A", "B", "response")), **found, **families})
    return prices


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

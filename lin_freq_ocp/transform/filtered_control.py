"""The part of a control in a band, with a price or a limit: a filter of the control as states of the problem."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.base import component_indices
from lin_freq_ocp.transform.reformulations import AddedStates, add_states

Kind = Literal["bandpass", "highpass", "lowpass", "bandstop"]
KINDS: dict[str, Kind] = {"notch": "bandpass", "low_pass": "highpass", "high_pass": "lowpass", "band_pass": "bandstop"}
"""The filter that keeps what a band would remove."""


def filtered_control(
    problem: OptimalControlProblem, band: Band, order: int = 2, price: float | None = None, limit: float | None = None
) -> OptimalControlProblem:
    """Return the problem with a price or a limit on the part of its controls in a band, by a filter in its states.

    A Butterworth filter, z_{t+1} = F z_t + G u_t, y_t = H z_t + J u_t, z_0 = 0, keeps what the band would remove. A
    control loop knows z exactly, so that it takes the same measured states as without the filter, in Python and in
    generated C. Every applied control that begins a plan with the hard limit satisfies it: this bounds the filtered
    signal itself, and the amplitude of windows by the docs' formula only. A price promises nothing; a step with a hard
    limit may have no plan, so that ``soft={"stage_rows": ...}`` belongs to it. For an amplitude that must not be
    exceeded, use ``lfo.spectrum.closed_loop``.

    Parameters
    ----------
    problem : OptimalControlProblem
    band : Band
        The frequencies to reduce, as of ``notch`` or ``low_pass``: those which the band would remove; not given by
        bins. It names one control, or is for all.
    order : int
        Of the filter: a notch takes 2 order states for each control, a low or high pass order states.
    price : float, optional
        Above zero: the cost has sum_t price/2 y_t^2 of each control in addition, less a constant with a ``u_ref``.
        A ``u_ref`` that a step of a loop previews does not change y.
    limit : float, optional
        Of |y_t|, in the unit of the control, above zero.

    Returns
    -------
    OptimalControlProblem
        With states named after the control and the band, and stage rows of the same name with a limit.

    Raises
    ------
    ProblemError
        If a value is not of this kind, or an edge is not between zero and half of the sampling rate.

    References
    ----------
    Gupta, "Frequency-shaped cost functionals", Journal of Guidance and Control 3(6), 1980.

    Examples
    --------
    >>> band = lfo.spectrum.notch(centre_hz=12, width_hz=8)
    >>> lfo.filtered_control(lfo.library.double_integrator(), band, price=10.0).state_dim
    6
    """
    require_problem(problem)
    count, given = positive_integer("order", order), (("price", price), ("limit", limit))
    weight, bound = (0.0 if value is None else positive_number(field, value) for field, value in given)
    if not weight and not bound:
        raise ProblemError("price, limit", "neither", "a price above zero, a limit, or both")
    if getattr(band, "kind", "") not in KINDS:
        expected = "a band of frequencies"
        raise ProblemError("band", brief(band), expected, "Such as lfo.spectrum.notch(centre_hz=12, width_hz=8).")
    of_nyquist = band.bins_per_unit(2, problem.sampling_time, "band")
    edges = [edge * of_nyquist for edge in band.limits if edge and np.isfinite(edge)]
    if len(edges) != 1 + (band.kind in ("notch", "band_pass")) or not all(0 < edge < 1 for edge in edges):
        raise ProblemError("band", str(band), "edges above zero and below half of the sampling rate")
    for j in component_indices("band", band.component, problem.control_names):
        words, states = str(replace(band, component=None)), _filter(count, edges, KINDS[band.kind])
        problem = _with_filter(problem, j, words, states, weight, bound)
    return problem


def _filter(order: int, edges: list[float], kind: Kind) -> tuple[Array, Array, Array, float]:
    """Return F, G, H and J of a cascade of sections, with states of unit size for controls of unit size."""
    from scipy import linalg, signal  # here, because it takes a second to import

    F, G, H, J = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for b0, b1, b2, _, a1, a2 in signal.butter(order, np.squeeze(edges), kind, output="sos"):
        states = 2 if a2 or b2 else 1
        A = np.array([[-a1, 1.0], [-a2, 0.0]])[:states, :states]
        B = np.array([b1 - a1 * b0, b2 - a2 * b0])[:states]
        F = np.block([[F, np.zeros((len(F), states))], [np.outer(B, H), A]])
        G, H, J = np.append(G, J * B), np.append(b0 * H, np.eye(states)[0]), b0 * J
    sizes = np.sqrt(np.diag(linalg.solve_discrete_lyapunov(F, np.outer(G, G))))
    return F * sizes / sizes[:, None], G / sizes, H * sizes, J


def _with_filter(
    problem: OptimalControlProblem,
    j: int,
    words: str,
    states: tuple[Array, Array, Array, float],
    price: float,
    limit: float,
) -> OptimalControlProblem:
    """Return the problem with the states of a filter of control j, a price on its output, and a limit."""
    (F, G, H, J), (label, unit) = states, split_unit(problem.control_names[j])
    n, k, acting = problem.state_dim, len(F), np.eye(problem.control_dim)[j]
    names = [f"{label}, {words}, {i + 1}" + (f" [{unit}]" if unit else "") for i in range(k)]
    rest = Box(np.zeros(k), np.zeros(k))
    filtered = add_states(problem, AddedStates(F, G[:, None] * acting, rest, np.full(k, -np.inf), names))
    h, g, cost = np.append(np.zeros(n), H), J * acting, filtered.quadratic
    of_reference = price * np.asarray(cost.u_ref @ g)[..., None]  # the cost is of u - u_ref, the filter's input is u
    cost = replace(
        cost,
        Q=cost.Q + price * np.outer(h, h),
        R=cost.R + price * np.outer(g, g),
        S=cost.S + price * np.outer(h, g),
        q=cost.q + of_reference * h,
        r=cost.r + of_reference * g,
    )
    rows = [StageRows([h, -h], [g, -g], [limit, limit], name=f"{label}, {words}")] if limit else []
    whole = CostSum([cost, *filtered.cost.norms])
    return replace(filtered, cost=whole, stage_rows=[*filtered.stage_rows, *rows])

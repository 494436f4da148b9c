"""The proof that a problem is infeasible: multipliers with eta_C = 0 whose bound D is above 0, and what carries it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.hamiltonian import extremal_at
from lin_freq_ocp.certificate.response_bound import farkas_bound
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import at_frequencies
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

CLEAR_MARGIN = 1e-4  # margin of a proof from which half of its bound is far above the rounding of data
SHARE_TOLERANCE = 0.1
"""Bounds on a component with less than this share of the heaviest ones in a proof are not named."""

SMALL_TIME = 1e-2
"""Times and bins at which a block acts with less than this fraction of its largest multiplier are not named."""

PRACTICAL = 1e4
"""Multiple of the sizes in the data beyond which a trajectory is not looked for where nothing bounds it."""

OVER_BINS = ("stop band", "mask", "energy bound")
"""Words in the names of blocks that act at bins and not at times."""


@dataclass(frozen=True)
class Conflict:
    """One block of constraints that an infeasibility proof rests on.

    Attributes
    ----------
    block : str
        In words, with the component's name.
    share : float
        1 for ends, stop bands and terms, without which the ray proves nothing; for bounds and joint rows, how much of
        the proof would be lost if they were relaxed by their own size, relative to the heaviest ones.
    times : tuple of int
        Where it acts; bins for a stop band.
    """

    block: str
    share: float
    times: tuple[int, ...]

    def __str__(self) -> str:
        where = "bins" if any(word in self.block for word in OVER_BINS) else "t ="
        return f"{self.block}, {where} {_runs(self.times)}"


@dataclass(frozen=True, eq=False)
class InfeasibilityProof:
    """Multipliers with eta_C = 0 whose bound D is above 0: no trajectory satisfies all constraints.

    Attributes
    ----------
    bound : Bound
        Its kind is "numerical" if, in components without bounds, only trajectories of practical size are excluded.
    multipliers : Multipliers
        The verified ray.
    conflict : tuple of Conflict
        The blocks of constraints that carry it.
    """

    bound: Bound
    multipliers: Multipliers
    conflict: tuple[Conflict, ...]


def prove_infeasible(problem: OptimalControlProblem, ray: Multipliers) -> InfeasibilityProof | None:
    """Return a proof of infeasibility from a Farkas ray (its eta_C is taken as 0), or None if it proves nothing."""
    abnormal, problem = replace(ray, eta_C=0.0, weights=None), at_frequencies(problem, ray.frequencies)
    bound = _bound(problem, abnormal)
    if bound.value <= 0:
        return None
    conflict = tuple(one for find in (_ends, _bounds, _bands, _terms) for one in find(problem, abnormal))
    return InfeasibilityProof(bound, abnormal, conflict)


def proof_margin(problem: OptimalControlProblem, ray: Multipliers) -> float:
    """Return the bound D of a Farkas ray relative to the terms that it is a difference of: 1 at best."""
    rest, bound = _rest(problem), _bound(problem, ray)
    residual = rest.x[1:] - problem.equations.successors(rest.x, rest.u)
    terms = float(np.abs(ray.eta * residual).sum()) + abs(bound.stage_term)
    if bound.stage_gaps is not None:
        terms += float(np.abs(bound.stage_gaps).sum())
    return bound.value / terms if terms > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Exclusion:
    """A rigorous ray that excludes initial states: its bound is an affine function of them.

    From x_0, it is ``value`` + slope (x_0 - start) > 0: the ray has no cost, and l_0 is linear at the fixed x_0.
    """

    start: Array
    slope: Array
    value: float

    def excludes(self, state: Array) -> bool:
        """Whether the bound from a state (n,) is at least half of that from ``start``: above all rounding."""
        return self.value + float(self.slope @ (state - self.start)) >= 0.5 * self.value


def exclusion(problem: OptimalControlProblem, ray: Multipliers) -> Exclusion | None:
    """Return what a ray proves of other initial states; None unless it excludes the problem's own, a point, clearly."""
    bound = _bound(problem, ray)
    start = problem.initial_box
    if not start.fixed.all() or bound.kind != RIGOROUS or proof_margin(problem, ray) <= CLEAR_MARGIN:
        return None
    return Exclusion(start.lower, -extremal_at(problem, _rest(problem), ray).in_x[0].astype(np.float64), bound.value)


def _rest(problem: OptimalControlProblem) -> Trajectory:
    """Return the point nearest to zero within the bounds, at every time."""
    return Trajectory(
        problem.state_tube.project(np.zeros((problem.horizon + 1, problem.state_dim))),
        problem.control_tube.project(np.zeros((problem.horizon, problem.control_dim))),
    )


def _bound(problem: OptimalControlProblem, ray: Multipliers) -> Bound:
    x, u = stated_sizes(problem)
    return farkas_bound(extremal_at(problem, _rest(problem), ray), (PRACTICAL * x, PRACTICAL * u))


def _ends(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    for what, t, end in (("initial state", 0, problem.initial_box), ("terminal state", -1, problem.terminal_box)):
        if ray.mu[t, np.isfinite(end.lower) | np.isfinite(end.upper)].any():
            yield Conflict(what, 1.0, (t % len(ray.mu),))


def _bounds(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the bounds and joint rows that weigh most, by their multipliers times the sizes of what they bound."""
    x, u = stated_sizes(problem)
    inside = np.abs(ray.mu) * x
    for t, end in ((0, problem.initial_box), (-1, problem.terminal_box)):
        inside[t, np.isfinite(end.lower) | np.isfinite(end.upper)] = 0.0
    blocks = [(f"state bound on {name}", inside[:, i]) for i, name in enumerate(problem.state_names)]
    outside = np.abs(ray.nu) * u
    blocks += [(f"control bound on {name}", outside[:, j]) for j, name in enumerate(problem.control_names)]
    for family in problem.stage_rows:
        joint = np.maximum(ray.stage.get(family.name, np.zeros((problem.horizon, family.rows))), 0.0)
        weighted = joint * family.sizes(x, u)
        blocks += [(f"row {i} of {family.name}", weighted[:, i]) for i in range(family.rows)]
    largest = max(float(weights.sum()) for _, weights in blocks)
    for block, weights in blocks:
        if weights.sum() > SHARE_TOLERANCE * largest:
            yield Conflict(block, float(weights.sum()) / largest, _important(weights))


def _bands(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the stop bands without whose multipliers the ray proves nothing."""
    for kind, names, prices in (
        ("state", problem.state_names, ray.rho_x),
        ("control", problem.control_names, ray.rho_u),
    ):
        for i, name in enumerate(names):
            rest = prices.copy()
            rest[:, i] = 0.0
            without = replace(ray, rho_x=rest) if kind == "state" else replace(ray, rho_u=rest)
            if prices[:, i].any() and _bound(problem, without).value <= 0:
                yield Conflict(f"{kind} stop band on {name}", 1.0, _important(np.abs(prices[:, i])))


def _terms(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the terms other than joint rows without whose multipliers the ray proves nothing."""
    for term in problem.terms:
        weights = ray.stage.get(term.name)
        if term.kind == "stage rows" or weights is None or not weights.any():
            continue
        rest = {name: one for name, one in ray.stage.items() if name != term.name}
        if _bound(problem, replace(ray, stage=rest)).value <= 0:
            positions = term.map.positions
            acting = _important(np.abs(weights).sum(1)) if len(weights) == len(positions) else range(len(positions))
            yield Conflict(term.name, 1.0, tuple(sorted({int(positions[i]) for i in acting})))


def _important(weights: Array) -> tuple[int, ...]:
    return tuple(int(t) for t in np.flatnonzero(weights > SMALL_TIME * weights.max()))


def _runs(times: tuple[int, ...]) -> str:
    """Return increasing whole numbers as runs: 0..3, 7."""
    runs: list[list[int]] = []
    for t in times:
        if runs and t == runs[-1][1] + 1:
            runs[-1][1] = t
        else:
            runs.append([t, t])
    shown = [f"{first}" if first == last else f"{first}..{last}" for first, last in runs[:4]]
    return ", ".join(shown) + (", ..." if len(runs) > 4 else "")

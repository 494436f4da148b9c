"""The judgement: every condition of the theorem and the global bound; and the proof that a problem is infeasible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.certificate.bound import Bound, lower_bound, ray_bound
from lin_freq_ocp.certificate.conditions import Condition, all_conditions
from lin_freq_ocp.certificate.hamiltonian import Lift, lift
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.measures import stated_sizes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

GAP_TOLERANCE = 1e-6
"""Relative gap (J - D)/max(1, |J|) up to which a feasible point is called globally optimal."""

SHARE_TOLERANCE = 0.1
"""A block of bounds or bins with less than this share of the heaviest one in an infeasibility proof is not named."""

SMALL_TIME = 1e-2
"""Times and bins at which a block acts with less than this fraction of its largest multiplier are not named."""

PRACTICAL = 1e4
"""Multiple of the sizes in the data beyond which a trajectory is not looked for where nothing bounds it."""

FEASIBILITY_LABELS = ("state equation", "C-vi", "C-vii", "S-x", "S-u")


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven of a trajectory with multipliers.

    Attributes
    ----------
    pmp : str
        "satisfied", "violated" or "not_applicable" (no multipliers to judge).
    normal : bool or None
        Whether eta_C = 1.
    conditions : tuple of Condition
        All that was checked, in the paper's order.
    cost : float
        J of the trajectory.
    bound : Bound or None
        The global lower bound; None if the cost is not convex or eta_C is not 1.
    """

    pmp: str
    normal: bool | None
    conditions: tuple[Condition, ...]
    cost: float
    bound: Bound | None

    @property
    def lower_bound(self) -> float | None:
        """Return D, a lower bound on the cost of every feasible trajectory; None if there is none."""
        return None if self.bound is None or not np.isfinite(self.bound.value) else self.bound.value

    @property
    def gap(self) -> float | None:
        """Return (J - D) / max(1, |J|)."""
        return None if self.lower_bound is None else (self.cost - self.lower_bound) / max(1.0, abs(self.cost))

    @property
    def stage_gaps(self) -> Array | None:
        """Return what each stage adds to J - D, shape (T+1,)."""
        return None if self.bound is None else self.bound.stage_gaps

    @property
    def feasible(self) -> bool:
        """Whether every constraint of the problem holds within tolerance."""
        return all(
            condition.passed
            for condition in self.conditions
            if condition.label in FEASIBILITY_LABELS or condition.name in FEASIBILITY_LABELS
        )

    @property
    def globally_optimal(self) -> bool:
        """Whether the trajectory is feasible and its gap to the bound is within tolerance."""
        return self.feasible and self.gap is not None and self.gap <= GAP_TOLERANCE

    @property
    def failed(self) -> tuple[Condition, ...]:
        """Return the conditions that do not hold."""
        return tuple(condition for condition in self.conditions if not condition.passed)

    @property
    def worst(self) -> Condition:
        """Return the condition with the largest residual relative to its scale."""
        return max(self.conditions, key=lambda condition: condition.relative)


def judge(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Certificate:
    """Judge a trajectory and multipliers from any source against the maximum principle.

    Raises
    ------
    ProblemError
        If shapes do not fit the problem, or a free bin has a multiplier.
    """
    lifted = lift(problem, trajectory, multipliers)
    conditions = all_conditions(lifted)
    return Certificate(
        pmp="satisfied" if all(condition.passed for condition in conditions) else "violated",
        normal=multipliers.eta_C == 1,
        conditions=conditions,
        cost=problem.cost.value(trajectory.x, trajectory.u),
        bound=lower_bound(lifted) if multipliers.eta_C == 1 else None,
    )


@dataclass(frozen=True)
class Conflict:
    """One block of constraints that an infeasibility proof rests on.

    Attributes
    ----------
    block : str
        In words, with the component's name.
    share : float
        What the proof would lose if the block were relaxed by its own size, relative to the heaviest bound or band;
        1 for an end, without which there is no proof.
    times : tuple of int
        Where it acts; bins for a stop band.
    """

    block: str
    share: float
    times: tuple[int, ...]

    def __str__(self) -> str:
        where = "bins" if "stop band" in self.block else "t ="
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
    rest = Trajectory(
        problem.state_tube.project(np.zeros((problem.horizon + 1, problem.state_dim))),
        problem.control_tube.project(np.zeros((problem.horizon, problem.control_dim))),
    )
    abnormal = Multipliers(0.0, ray.eta, ray.mu, ray.nu, ray.rho_u, ray.rho_x)
    lifted = lift(problem, rest, abnormal)
    sizes = stated_sizes(problem)
    bound = ray_bound(lifted, (PRACTICAL * sizes[0], PRACTICAL * sizes[1]))
    return InfeasibilityProof(bound, abnormal, _conflict(lifted, *sizes)) if bound.value > 0 else None


def _conflict(lifted: Lift, x_size: Array, u_size: Array) -> tuple[Conflict, ...]:
    """Name the blocks that carry the ray, ends first."""
    problem, multipliers = lifted.problem, lifted.multipliers
    at_x, named = np.abs(multipliers.mu) * x_size, list[Conflict]()
    for what, t, end in (("initial state", 0, problem.initial_state), ("terminal state", -1, problem.terminal_state)):
        stated = np.isfinite(end.lower) | np.isfinite(end.upper)
        if at_x[t, stated].any():
            named.append(Conflict(what, 1.0, (t % len(at_x),)))
        at_x[t, stated] = 0.0
    blocks = dict[str, Array]()
    for i, name in enumerate(problem.state_names):
        blocks[f"state bound on {name}"] = at_x[:, i]
        blocks[f"state stop band on {name}"] = np.abs(multipliers.rho_x[:, i]) * x_size[i]
    for j, name in enumerate(problem.control_names):
        blocks[f"control bound on {name}"] = np.abs(multipliers.nu[:, j]) * u_size[j]
        blocks[f"control stop band on {name}"] = np.abs(multipliers.rho_u[:, j]) * u_size[j]
    largest = max(float(weights.sum()) for weights in blocks.values())
    for block, weights in blocks.items():
        if weights.sum() > SHARE_TOLERANCE * largest:
            named.append(Conflict(block, float(weights.sum()) / largest, _important(weights)))
    return tuple(named)


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

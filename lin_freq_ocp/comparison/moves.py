"""The shortest moves that leave no more than a residual vibration: of input shapers, and of the problem itself.

A shaper makes a move longer by its last impulse, and calmer. For each, the least profile is looked for, of those that
are optimal without the bound on the vibration, whose shaped control keeps all of the problem's constraints; the
vibration over the box is bounded with proof, for all moves alike.

With the half period of damped vibration, pi / (w sqrt(1 - zeta^2)), and K = exp(-zeta pi / sqrt(1 - zeta^2)), which is
what a vibration keeps over it, impulses half a period apart have the amplitudes, but for the factor that makes their
sum one,

    ZV   1, K                zero vibration at (w, zeta);
    ZVD  1, 2 K, K^2         and its derivative by w is zero: ZV convolved with itself;
    EI   (1 + V)/4, (1 - V)/2 K, (1 + V)/4 K^2    V of the vibration there, and zero on both sides of w.

The formula of EI is exact without damping, and the usual first approximation with it. Impulses stand on the samples
nearest to their times.

References: Singer and Seering, Journal of Dynamic Systems, Measurement, and Control 112, 1990 (ZV, ZVD). Singhose,
Command Generation for Flexible Systems, PhD thesis, MIT 1997 (EI).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.batch.minimum_time import Search, obstacles, problem_at_horizon, search_horizons
from lin_freq_ocp.certificate.peaks import Peak, proven_peak
from lin_freq_ocp.certificate.tolerances import PEAK_TOLERANCE
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, replay_control
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import semi_infinite_terms
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome

INSENSITIVITY = 0.05  # V of EI: the customary 5 %

FREQUENCIES, DAMPINGS = 401, 9  # at which the vibration is shown, and over which its largest value is taken
BESIDE = 1.5  # widths of the box that are shown on each of its sides
LEAST_BESIDE = 0.25  # of its highest frequency, if it is narrow
HIGHEST_LIMIT = 3.0  # limits that fit into the picture

OURS, UNSHAPED = "optimal", "unshaped"
LONGEST_PROFILE = 4  # times the shortest profile: longer profiles are not tried
TRIED = 100  # profiles at most: of long moves, not every length is tried

Solve = Callable[[OptimalControlProblem], Outcome]


@dataclass(frozen=True, eq=False)
class Move:
    """A move of some samples: its name, how it is made, and its largest vibration over the box."""

    name: str
    description: str
    measured: MeasuredTrajectory | None  # None: there is none of at most so many samples
    samples: int
    sampling_time: float  # seconds
    peaks: tuple[Peak, ...] = ()  # of each control with a bound

    @property
    def seconds(self) -> float:
        """Return its duration, or the longest that was tried."""
        return self.samples * self.sampling_time

    def __str__(self) -> str:
        length = f"{self.samples} samples, {number(self.seconds, 4)} s"
        if self.measured is None:
            return f"none of at most {length}"
        return f"{length}, vibration at most {number(self.ratio, 4)} of its limit"

    @property
    def ratio(self) -> float | None:
        """Return the largest vibration over its limit, proven; None without a move."""
        return max((peak.ratio for peak in self.peaks), default=None)

    @property
    def keeps_everything(self) -> bool:
        """Whether it keeps all constraints of the problem, the bound on the vibration with proof."""
        found = self.measured
        if found is None or not found.meaningful or self.ratio is None or self.ratio > 1 + PEAK_TOLERANCE:
            return False
        parts = (found.controls, found.states, found.end, found.terms)
        return all(bool(part.passed.all()) for part in parts if part is not None)


@dataclass(frozen=True, eq=False)
class Moves:
    """The shortest moves: without a bound on the vibration, by shapers, and with the bound in the problem."""

    problem: OptimalControlProblem
    unshaped: Move
    shaped: tuple[Move, ...]
    ours: Move
    proof: bool  # that one sample less than ours is infeasible

    @property
    def all(self) -> tuple[Move, ...]:
        """Return all moves, that of the problem last."""
        return (self.unshaped, *self.shaped, self.ours)


def shortest_moves(problem: OptimalControlProblem, solve: Solve, names: Sequence[str]) -> Moves:
    """Return the shortest moves of a problem for which ``why_not_shaped`` says nothing."""
    free = replace(problem, control_spectrum=None)
    before, ours = _search_least_horizon(free, solve), _search_least_horizon(problem, solve)
    plan = cache(lambda T: solve(problem_at_horizon(free, T)).trajectory)
    shortest = before.horizon or problem.horizon
    return Moves(
        problem,
        _move_of_search(UNSHAPED, "without the bound on the vibration", before, problem),
        tuple(_shaped_move(name, problem, plan, shortest) for name in names),
        _move_of_search(OURS, "with the bound in the problem", ours, problem),
        ours.horizon is not None and (ours.horizon == 1 or ours.horizon - 1 in ours.proven),
    )


def _search_least_horizon(problem: OptimalControlProblem, solve: Solve) -> Search:
    return search_horizons(1, problem.horizon, True, lambda T: solve(problem_at_horizon(problem, T)))


def _move_of_search(name: str, description: str, search: Search, problem: OptimalControlProblem) -> Move:
    if search.best is None or search.best.trajectory is None:
        return Move(name, description, None, problem.horizon, boxes_of(problem)[0].sampling_time)
    trajectory = search.best.trajectory
    return _measured_move(
        name, description, MeasuredTrajectory(name, problem_at_horizon(problem, len(trajectory.u)), trajectory)
    )


def _measured_move(name: str, description: str, measured: MeasuredTrajectory) -> Move:
    x, u = measured.trajectory.x, measured.trajectory.u
    boxes = boxes_of(measured.problem)
    peaks = tuple(proven_peak(box, box.map.signal(x, u)) for box in boxes)
    return Move(name, description, measured, len(u), boxes[0].sampling_time, peaks)


def _shaped_move(
    name: str, problem: OptimalControlProblem, plan: Callable[[int], Trajectory | None], shortest: int
) -> Move:
    box = boxes_of(problem)[0]
    longer, description = len(impulses(name, box)) - 1, impulse_text(name, box)
    step = -(-(LONGEST_PROFILE - 1) * shortest // TRIED)
    description += "" if step == 1 else f"; profiles tried are {step} samples apart"
    for T in range(shortest, LONGEST_PROFILE * shortest, step):
        profile = plan(T)
        if profile is None:
            continue
        at = problem_at_horizon(problem, T + longer)
        held = np.concatenate([profile.x, np.repeat(profile.x[-1:], longer, axis=0)])
        u = shaped(name, box, profile.u)
        move = _measured_move(name, description, replay_control(name, at, u, Trajectory(held, u)))
        if move.keeps_everything:
            return move
    return Move(name, description, None, LONGEST_PROFILE * shortest + longer - 1, box.sampling_time)


def why_not_shaped(problem: OptimalControlProblem) -> str:
    """Say why input shapers are no competitors of a problem with a bound on residual vibrations; else nothing."""
    boxes = boxes_of(problem)
    if not boxes:
        return "no control has a bound on its residual vibration"
    if any((box.low != boxes[0].low).any() or (box.high != boxes[0].high).any() for box in boxes):
        return "the controls have boxes of modes that differ"
    try:
        problem_at_horizon(problem, problem.horizon + 1)
    except ProblemError as error:
        return f"{error.field}: it depends on time"
    return "; ".join(obstacles(lambda _: problem, 1, problem.horizon, same_data=True))


def boxes_of(problem: OptimalControlProblem) -> tuple[VibrationLimit, ...]:
    """Return the boxes of modes that controls must not leave ringing."""
    terms = semi_infinite_terms(problem, VibrationLimit)
    return tuple(box for term, box in terms if term.kind.of == "controls")


# The amplitudes of each shaper over K^0, K^1, ..., not scaled.
SHAPERS: dict[str, Sequence[float]] = {
    "ZV": (1.0, 1.0),
    "ZVD": (1.0, 2.0, 1.0),
    "EI": ((1 + INSENSITIVITY) / 4, (1 - INSENSITIVITY) / 2, (1 + INSENSITIVITY) / 4),
}


def impulses(name: str, box: VibrationLimit) -> Array:
    """Return the impulses of a shaper for the middle of a box of modes, on the samples; their sum is one."""
    frequency, damping = (box.low + box.high) / 2
    root = float(np.sqrt(1 - damping**2))
    K, factors = float(np.exp(-np.pi * damping / root)), np.array(SHAPERS[name])
    amplitudes = factors * K ** np.arange(len(factors))
    half_period = 1 / (2 * frequency * root * box.sampling_time)
    at = np.rint(half_period * np.arange(len(amplitudes))).astype(int)
    found = np.zeros(at[-1] + 1)
    np.add.at(found, at, amplitudes / amplitudes.sum())
    return found


def shaped(name: str, box: VibrationLimit, u: Array) -> Array:
    """Return controls (T, m), each convolved with the impulses of a shaper, and longer by their length less one."""
    given = impulses(name, box)
    return np.stack([np.convolve(column, given) for column in u.T], axis=1)


def impulse_text(name: str, box: VibrationLimit) -> str:
    """Return the impulses of a shaper in words."""
    given = impulses(name, box)
    at = np.flatnonzero(given)
    return ", ".join(f"{given[t]:.4g} at t = {t}" for t in at)


def frequencies_around(box: VibrationLimit) -> Array:
    """Return the natural frequencies at which vibrations are shown, in Hz."""
    low, high = float(box.low[0]), float(box.high[0])
    beside = max(BESIDE * (high - low), LEAST_BESIDE * high)
    return np.linspace(max(low - beside, 0.05 * low), high + beside, FREQUENCIES)


def vibration(box: VibrationLimit, trajectory: Trajectory, frequencies: Array) -> Array:
    """Return what a trajectory leaves at natural frequencies, the largest over the box's damping ratios."""
    dampings = np.linspace(box.low[1], box.high[1], DAMPINGS)
    modes = np.stack(np.meshgrid(frequencies, dampings, indexing="ij"), axis=-1).reshape(-1, 2)
    signal = box.map.signal(trajectory.x, trajectory.u)
    return np.abs(box.map.at_points(modes).transform(signal)).reshape(len(frequencies), -1).max(axis=1)

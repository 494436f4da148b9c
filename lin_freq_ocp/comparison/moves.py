"""The shortest moves that leave no more than a residual vibration: of input shapers, and of the problem itself.

A shaper makes a move calmer, and longer by its last impulse. For each shaper the search takes profiles that are optimal
without the bound on the vibration, from the shortest one on, until the shaped control keeps all constraints of the
problem. The vibration over each box of modes is bounded with proof, for all moves alike.

The impulses of a shaper for several modes are those for each mode, convolved. If states remember controls, as a rate
limit adds them, the profiles start after a control of zero and end with one: then the shaped control, an average of
shifted profiles, changes no faster than these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.batch.minimum_time import Search, obstacles, problem_at_horizon, search_horizons
from lin_freq_ocp.certificate.peaks import Peak, proven_peak
from lin_freq_ocp.certificate.tolerances import PEAK_TOLERANCE
from lin_freq_ocp.comparison.shapers import known_shaper
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, replay_control
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, SetOrSets
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.limits import replace_bounds
from lin_freq_ocp.transform.reformulations import semi_infinite_terms

FREQUENCIES, DAMPINGS = 401, 9  # at which the vibration is shown, and over which its largest value is taken
WIDTHS_OUTSIDE = 1.5  # widths of the box that are shown on each of its sides
LEAST_OUTSIDE = 0.25  # of its highest frequency, if it is narrow
HIGHEST_LIMIT = 3.0  # limits that fit into the picture

OURS, UNSHAPED = "optimal", "unshaped"
LONGEST_PROFILE = 4  # times the shortest profile: longer profiles are not tried
TRIED = 100  # most profiles: of long moves, not every length is tried

Solve = Callable[[OptimalControlProblem, bool], Outcome]  # whether any feasible trajectory is an answer


@dataclass(frozen=True, eq=False)
class Move:
    """A move: its name, its description, its length, and its largest vibration over each box of modes."""

    name: str
    description: str
    measured: MeasuredTrajectory | None  # None: no move of at most ``samples`` samples was found
    samples: int
    sampling_time: float  # seconds
    peaks: tuple[Peak, ...] = ()  # for each box of modes

    @property
    def seconds(self) -> float:
        """Return its duration; without a move, the longest duration tried."""
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
        measured = self.measured
        if measured is None or not measured.meaningful or self.ratio is None or self.ratio > 1 + PEAK_TOLERANCE:
            return False
        parts = (measured.controls, measured.states, measured.end, measured.terms)
        return all(bool(part.passed.all()) for part in parts if part is not None)


@dataclass(frozen=True, eq=False)
class Moves:
    """The shortest moves without a bound on the vibration, by shapers, and with the bound in the problem."""

    problem: OptimalControlProblem
    unshaped: Move
    shaped: tuple[Move, ...]
    ours: Move
    proof: bool  # whether one sample less than ours is proven infeasible

    @property
    def all(self) -> tuple[Move, ...]:
        """Return all moves; the last is the optimal one."""
        return (self.unshaped, *self.shaped, self.ours)


@activity_step("shortest moves")
def shortest_moves(problem: OptimalControlProblem, solve: Solve, names: Sequence[str]) -> Moves:
    """Return the shortest moves of a problem for which ``why_not_shaped`` returns nothing."""
    monotone = not obstacles(lambda _: problem, 1, problem.horizon, same_data=True)
    free = replace(problem, control_spectrum=None)
    profiles = remember_zero(free)

    @cache
    def solve_at(variant: OptimalControlProblem, T: int, any_point: bool = False) -> Outcome:
        with activity_step(f"{T} samples"):
            return solve(problem_at_horizon(variant, T), any_point)

    def search(variant: OptimalControlProblem, low: int, bisect: bool) -> Search:
        def solve_variant(T: int, any_point: bool) -> Outcome:
            return solve_at(variant, T, any_point) if variant is problem else solve_at(variant, T)

        return search_horizons(low, problem.horizon, bisect, solve_variant)

    unshaped = search(free, 1, monotone)
    least = unshaped.horizon or problem.horizon  # of all searches: the other problems have more constraints
    ours = search(problem, least, monotone)
    shortest = least if profiles is free else search(profiles, least, True).horizon or problem.horizon
    infeasible = {0, *unshaped.proven, *ours.proven}
    return Moves(
        problem,
        _move_of_search(UNSHAPED, "without the bound on the vibration", unshaped, problem),
        tuple(_shaped_move(name, problem, partial(solve_at, profiles), shortest) for name in names),
        _move_of_search(OURS, "with the bound in the problem", ours, problem),
        ours.horizon is not None and ours.horizon - 1 in infeasible,
    )


def remember_zero(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem with zeros at both ends for states that remember controls, if zero is admissible there.

    Such a state has x_{t+1} = B u_t, without x_t, as a rate limit adds them. Other problems are returned themselves.
    """
    linear = problem.linear
    memory = ~(linear.A.reshape(-1, *linear.A.shape[-2:]).any(axis=(0, 2)) | np.atleast_2d(linear.offset).any(axis=0))
    ends = dict[str, SetOrSets]()
    for name, box in (("initial_state", problem.initial_box), ("terminal_state", problem.terminal_box)):
        zero = memory & (box.lower <= 0) & (box.upper >= 0)
        if (box.lower[zero] < box.upper[zero]).any():
            fixed = Box(np.where(zero, 0.0, box.lower), np.where(zero, 0.0, box.upper))
            ends[name] = replace_bounds(getattr(problem, name), fixed)
    return replace(problem, **ends) if ends else problem


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


def _shaped_move(name: str, problem: OptimalControlProblem, solve_at: Callable[[int], Outcome], shortest: int) -> Move:
    boxes = boxes_of(problem)
    weights = impulses(name, boxes)
    longer, description = len(weights) - 1, impulse_text(weights)
    step = -(-(LONGEST_PROFILE - 1) * shortest // TRIED)
    description += "" if step == 1 else f"; profiles tried are {step} samples apart"
    for T in range(shortest, LONGEST_PROFILE * shortest, step):
        profile = solve_at(T).trajectory
        if profile is None:
            continue
        at = problem_at_horizon(problem, T + longer)
        planned = np.concatenate([profile.x, np.repeat(profile.x[-1:], longer, axis=0)])
        u = shape_controls(weights, profile.u)
        move = _measured_move(name, description, replay_control(name, at, u, Trajectory(planned, u)))
        if move.keeps_everything:
            return move
    return Move(name, description, None, LONGEST_PROFILE * shortest + longer - 1, boxes[0].sampling_time)


def why_not_shaped(problem: OptimalControlProblem) -> str:
    """Return in words why input shapers do not apply to a problem; empty if they do."""
    if not boxes_of(problem):
        return "no control has a bound on its residual vibration"
    try:
        problem_at_horizon(problem, problem.horizon + 1)
    except ProblemError as error:
        return f"{error.field}: it depends on time"
    try:
        profiles = remember_zero(problem)
    except UnsupportedError:
        return "the dynamics are not linear"
    return "; ".join(obstacles(lambda _: profiles, 1, problem.horizon, same_data=True))


def shaper_obstacle(problem: OptimalControlProblem) -> str:
    """Return in words why no input shaper applies to a problem that limits residual vibrations; empty for others."""
    return why_not_shaped(problem) if semi_infinite_terms(problem, VibrationLimit) else ""


def boxes_of(problem: OptimalControlProblem) -> tuple[VibrationLimit, ...]:
    """Return the boxes of modes whose residual vibration is limited, of all controls."""
    terms = semi_infinite_terms(problem, VibrationLimit)
    return tuple(box for term, box in terms if term.kind.of == "controls")


def impulses(name: str, boxes: Sequence[VibrationLimit]) -> Array:
    """Return the impulses of a shaper on the samples, (length,), whose sum is one.

    They are those for the centre of each box, convolved; equal boxes, as of several controls, count once.
    """
    weights = np.ones(1)
    for frequency, damping in dict.fromkeys(tuple((box.low + box.high) / 2) for box in boxes):
        weights = np.convolve(weights, known_shaper(name, frequency, damping).samples(boxes[0].sampling_time))
    return weights


def shape_controls(weights: Array, u: Array) -> Array:
    """Return controls (T, m), each convolved with impulses (length,): (T + length - 1, m)."""
    return np.stack([np.convolve(column, weights) for column in u.T], axis=1)


def impulse_text(weights: Array) -> str:
    """Return impulses in words."""
    return ", ".join(f"{weights[t]:.4g} at t = {t}" for t in np.flatnonzero(weights))


def frequencies_around(box: VibrationLimit) -> Array:
    """Return the natural frequencies at which vibrations are shown, in Hz."""
    low, high = float(box.low[0]), float(box.high[0])
    outside = max(WIDTHS_OUTSIDE * (high - low), LEAST_OUTSIDE * high)
    return np.linspace(max(low - outside, 0.05 * low), high + outside, FREQUENCIES)


def vibration(box: VibrationLimit, trajectory: Trajectory, frequencies: Array) -> Array:
    """Return the residual vibration at natural frequencies, (k,), the largest over the box's damping ratios."""
    dampings = np.linspace(box.low[1], box.high[1], DAMPINGS)
    modes = np.stack(np.meshgrid(frequencies, dampings, indexing="ij"), axis=-1).reshape(-1, 2)
    signal = box.map.signal(trajectory.x, trajectory.u)
    return np.abs(box.map.at_points(modes).transform(signal)).reshape(len(frequencies), -1).max(axis=1)

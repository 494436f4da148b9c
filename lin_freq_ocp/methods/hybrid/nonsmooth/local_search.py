"""Local optima of several mode sequences, each improved by changing one mode at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.methods.hybrid.nonsmooth.grid import grid_trajectories
from lin_freq_ocp.methods.hybrid.nonsmooth.sequential import PRICES, LocalOptimum, flipped, local_optimum
from lin_freq_ocp.methods.hybrid.smooth.barrier import End
from lin_freq_ocp.methods.hybrid.smooth.solver import is_smooth, smooth_optimum
from lin_freq_ocp.methods.progress import Progress
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.sizes import search_scale, stated_sizes
from lin_freq_ocp.problem.starts import Start
from lin_freq_ocp.problem.trajectory import Trajectory

SHARES = (0.5, 0.1, 0.9, 0.3, 0.7)  # constant controls to start from, between lower and upper bound
SMOOTH_STARTS = 2  # enough if there is an answer, where there are no modes to search
LONGEST_REPLAY = 2000  # steps of a start, where it need not be a trajectory
DECREASE = 1e-9  # part of the cost by which a better sequence is cheaper


@dataclass(frozen=True)
class SmoothProgress(Progress):
    """How far the search over piecewise-smooth dynamics is.

    Attributes
    ----------
    tried : int
        Starts of local searches.
    level : int
        Of the lattices of the bound; 0 before.
    share : float
        How much of the level is done, from 0 to 1.
    """

    tried: int
    level: int = 0
    share: float = 0.0

    def __str__(self) -> str:
        message = [f"cost {self.cost:.6g}" if np.isfinite(self.cost) else "no trajectory yet", f"{self.tried} starts"]
        if self.level:
            message.append(f"bound {self.lower_bound:.6g}, {self.share:.0%} of level {self.level}")
        return ", ".join(message)


@dataclass
class LocalSearch:
    """One search; ``run`` it once, then ``look_near`` other starts.

    ``best`` is the cheapest trajectory, else the point of least violation; ``tried`` counts starts; ``words`` say why
    the search stopped early; ``progress`` is called after every start, the first being ``start``.
    """

    problem: OptimalControlProblem
    seconds: float = np.inf
    progress: Callable[[SmoothProgress], None] | None = None
    start: Start | None = None
    best: LocalOptimum | None = None
    tried: int = 0
    message: str = ""
    interrupted: bool = False

    def __post_init__(self):
        self._end = now() + self.seconds
        self._known: set[tuple[bytes, bytes]] = set()
        self._units = stated_sizes(self.problem)[1]
        self._smooth = is_smooth(self.problem)

    def run(self) -> LocalSearch:
        """Search from all starts, then improve the best; from a given start alone if no modes are to be searched."""
        try:
            if self.start is not None:
                self._try(self.start.trajectory or self._held(SHARES[0]), self.start.sequence, warm=True)
                if self._smooth and self.best is not None and self.best.feasible:
                    return self
            self._on_grid(None)
            for trajectory, sequence in self._starts():
                found = self.best is not None and self.best.feasible
                if self._late() or (self._smooth and found and self.tried >= SMOOTH_STARTS):
                    break
                self._try(trajectory, sequence)
            if self._smooth and self.best is not None and not self.best.feasible:
                self._try(self.best.trajectory, self.best.sequence, warm=True)
            while not self._late() and (self._on_grid(self.best) or self._improved()):
                pass
        except KeyboardInterrupt:
            self.interrupted, self.message = True, "interrupted"
        return self

    def look_near(self, trajectory: Trajectory, sequence: Indices) -> bool:
        """Try one more start, and improve its local optimum; return whether that is a better trajectory."""
        before = self.best
        self._try(trajectory, sequence, PRICES[:1])
        while self.best is not before and self._improved():
            pass
        return self.best is not before and self.best is not None and self.best.feasible

    def _on_grid(self, local: LocalOptimum | None) -> bool:
        """Try the trajectory of a grid, with the frequency multipliers of a local optimum; return if it is better."""
        before = self.best
        constrained = self.problem.control_stop.any() or self.problem.state_stop.any()
        if self._smooth or (local is not None and (not constrained or not local.feasible)):
            return False
        multipliers = None if local is None else local.multipliers
        for trajectory in grid_trajectories(self.problem, multipliers, self._end):
            self._try(trajectory, piecewise_smooth(self.problem).sequence_of(trajectory.x, trajectory.u))
        return self.best is not before

    def _improved(self) -> bool:
        """Try the neighbours of the best sequence; return whether one of them is better."""
        before = self.best
        if before is None:
            return False
        for sequence in flipped(self.problem, before):
            if self._late():
                return False
            self._try(before.trajectory, sequence, PRICES[:1])
            if self.best is not before:
                return True
        return False

    def _try(self, start: Trajectory, sequence: Indices, prices: Sequence[float] = PRICES, warm: bool = False) -> None:
        key = sequence.tobytes(), np.round(start.u / self._units, 6).tobytes()
        if self._late() or key in self._known:
            return
        self._known.add(key)
        self.tried += 1
        found = self._optimum(start, sequence, prices, warm)
        if found is not None and (self.best is None or _better(self.problem, found, self.best)):
            self.best = found
        if self.progress is not None:
            known = self.best is not None and self.best.feasible
            self.progress(SmoothProgress(self.best.cost if known and self.best else np.inf, -np.inf, self.tried))

    def _optimum(
        self, start: Trajectory, sequence: Indices, prices: Sequence[float], warm: bool
    ) -> LocalOptimum | None:
        if self._smooth:
            try:
                found, ended = smooth_optimum(self.problem, start, self._end, warm)
            except UnsupportedError:  # too large for the structured method
                self._smooth = False
            else:
                self.interrupted = ended is End.INTERRUPTED
                return found
        return local_optimum(self.problem, start, sequence, prices, self._end)

    def _late(self) -> bool:
        if self.interrupted:
            self.message = "interrupted"
            return True
        if now() <= self._end:
            return False
        self.message = f"time limit of {self.seconds:g} s"
        return True

    def _starts(self) -> Iterator[tuple[Trajectory, Indices]]:
        """Yield trajectories of constant controls with their mode sequences, then with each mode alone."""
        dynamics = piecewise_smooth(self.problem)
        for share in SHARES:
            trajectory = self._held(share)
            alone = np.zeros(self.problem.horizon, dtype=np.intp)
            yield trajectory, alone if self._smooth else dynamics.sequence_of(trajectory.x, trajectory.u)
        for mode in range(len(dynamics.modes)):
            yield self._held(SHARES[0]), np.full(self.problem.horizon, mode, dtype=np.intp)

    def _held(self, share: float) -> Trajectory:
        """Return the trajectory of controls at a share between their bounds.

        Where there is none, the state is constant. Of one smooth map, whose replay may take long, it then goes straight
        from one end to the other.
        """
        tube, middle = self.problem.control_tube, np.full(self.problem.state_dim, 0.5)
        u, start = _middle(tube, np.full(tube.lower.shape, share)), _middle(self.problem.ends[0], middle)
        if not self._smooth or self.problem.horizon <= LONGEST_REPLAY:
            with suppress(NumericalError):
                return simulate(self.problem, u, start)
        box = self.problem.ends[1]
        bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
        end = np.where(bounded & self._smooth, _middle(box, middle), start)
        part = np.linspace(0.0, 1.0, self.problem.horizon + 1)[:, None]
        return Trajectory((1 - part) * start + part * end, u)


def _middle(box: Box, share: Array) -> Array:
    """Return a point of a box at a share between its bounds; at its only bound, or at zero, if it has not two."""
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    low = np.where(np.isfinite(lower), lower, np.minimum(np.where(np.isfinite(upper), upper, 0.0), 0.0))
    high = np.where(np.isfinite(upper), upper, np.maximum(low, 0.0))
    return low + share * (high - low)


def _better(problem: OptimalControlProblem, one: LocalOptimum, other: LocalOptimum) -> bool:
    if one.feasible != other.feasible:
        return one.feasible
    if not one.feasible:
        return one.violation < other.violation
    return one.cost < other.cost - DECREASE * search_scale(problem, other.trajectory)

"""One mode sequence of piecewise-affine dynamics, or of controls with levels, as a linear problem, and the way back.

The linear problem is a restriction: its rays and its bound do not hold for the other sequences of the search tree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.methods.hybrid.search.multipliers import multipliers_with_weights
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reductions import AnyAnswer, Reduced
from lin_freq_ocp.transform.reformulations import at_frequencies
from lin_freq_ocp.transform.simulation import simulate


@dataclass(frozen=True, eq=False)
class FixedModes(Reduced):
    """The linear problem of a mode sequence (T,), its regions as rows; a level is a mode that fixes the control."""

    sequence: Indices

    def trajectories(self, reduced: Trajectory) -> Iterator[Trajectory]:
        """Yield a solver's trajectory with the controls that the modes fix exactly at their levels.

        Its states are simulated; from a free initial state, a second trajectory has the solver's states, as unstable
        dynamics magnify rounding errors.
        """
        choices, start = self.given.form.choices, self.given.initial_box
        if choices is None:
            yield reduced
            return
        controls = np.where(np.isnan(choices[self.sequence]), reduced.u, choices[self.sequence])
        yield simulate(self.given, controls, start.project(reduced.x[0]))
        if not start.fixed.all():
            yield Trajectory(reduced.x, controls)

    def trajectory(self, reduced: Trajectory) -> Trajectory:
        """Return the first of these trajectories."""
        return next(self.trajectories(reduced))

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers with the weights of all modes whose regions contain the trajectory."""
        given = at_frequencies(self.given, reduced.frequencies)
        return reduced if at is None else multipliers_with_weights(given, at, self.sequence, reduced)

    def recover(self, answer: AnyAnswer) -> AnyAnswer:
        """Return the answer for the given problem, without a ray: that would exclude one sequence only."""
        return replace(super().recover(answer), ray=None)


def fix_modes(problem: OptimalControlProblem, sequence: Indices) -> FixedModes:
    """Return the linear problem of a mode sequence, and the way back; UnsupportedError without affine modes."""
    return FixedModes(problem, problem.with_modes(sequence), sequence)

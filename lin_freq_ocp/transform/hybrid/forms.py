"""Problems with modes in the standard forms that searches and the judge use."""

from __future__ import annotations

from lin_freq_ocp.problem.hybrid.affine_mode import ModeArrays
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.sizes import stated_sizes


def piecewise_affine(problem: OptimalControlProblem) -> PiecewiseAffineDynamics:
    """Return the dynamics of a problem, or raise UnsupportedError unless they are piecewise affine."""
    return problem.in_form(PiecewiseAffineDynamics)


def piecewise_smooth(problem: OptimalControlProblem) -> PiecewiseSmoothDynamics:
    """Return the dynamics of a problem, or raise UnsupportedError unless they are piecewise smooth."""
    return problem.in_form(PiecewiseSmoothDynamics)


def measured_modes(problem: OptimalControlProblem) -> ModeArrays:
    """Return the modes of a problem at all times, with the sizes of components that its data state."""
    arrays = piecewise_affine(problem).arrays(problem.horizon)
    return arrays.with_sizes(*stated_sizes(problem), problem.level_sizes)


def linear_along(problem: OptimalControlProblem, trajectory: Trajectory) -> OptimalControlProblem:
    """Return the linear problem of the modes along a trajectory; a problem without modes stays itself.

    It lacks costs by formulas, whose kinks remain boundaries of modes.
    """
    if problem.cost.has_formulas:
        problem = replace_fields(problem, dynamics=problem.form.standard_form, cost=problem.cost.without_formulas)
    problem = problem.affine_at(trajectory)
    if not problem.mode_names:
        return problem
    return problem.with_modes(measured_modes(problem).sequence(trajectory.x, trajectory.u))

"""The Fourier-domain method for linear time-invariant problems (SPECTRAL.md): read in the order of its steps.

``lti`` states the problem, ``resolvent`` and ``spaces`` solve the dynamics at every bin, ``border`` holds what no bin
owns, ``kernels`` and ``working_set`` what pointwise rows do to each other, ``structure`` ties these together;
``violations`` and ``exchange`` find the active rows with the small QPs of ``dual_qp``, from ``first_set``'s guess;
``rays`` prove infeasibility, ``recovery`` returns the theorem's multipliers, ``optimality`` checks the answer.
"""

from lin_freq_ocp.methods.spectral.model.row_form import row_form
from lin_freq_ocp.methods.spectral.solver import SpectralSolution, SpectralSolver

__all__ = ["SpectralSolution", "SpectralSolver", "row_form"]

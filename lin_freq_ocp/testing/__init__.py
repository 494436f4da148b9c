"""Conformance cases and random problems, to run against a solver of one's own; a check of terms of one's own.

``conformance_cases()`` have known optimal costs; ``random_case(family, seed)`` has one that this package proves:
"convex" (linear dynamics, bounds, stop bands), "lti" (the class of the Fourier-domain method), "linear" (any units,
degenerate dynamics), "mixed" (sets, terms and spectra of every kind), "kinks" (continuous piecewise-affine dynamics),
"infeasible". The generators are the modules ``random_convex``, ``random_lti``, ...; ``random_mixed`` has a CVXPY model
beside each problem, and ``oracle`` solves linear problems by plain Clarabel, sharing no code with the package.
``check_terms(problem)`` says what is wrong with costs, sets, rows and frequency constraints that you have written.

Examples
--------
>>> from lin_freq_ocp.testing import check, conformance_cases
>>> def my_solver(problem):  # OptimalControlProblem -> Trajectory, or None if infeasible
...     return lfo.solve(problem, throw=False).trajectory
>>> reports = [check(case, my_solver) for case in conformance_cases("linear")]
>>> [report.message for report in reports if not report.passed]
[]
"""

from lin_freq_ocp.testing.conformance import Case, Report, check, conformance_cases, random_case
from lin_freq_ocp.testing.terms import check_terms

__all__ = ["Case", "Report", "check", "check_terms", "conformance_cases", "random_case"]

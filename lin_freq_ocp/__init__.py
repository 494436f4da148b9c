"""Discrete-time optimal control with constraints in time and in frequency, with a certificate for every answer.

Read in the order of the data: ``problem`` describes, ``transcription`` turns a problem into a program, ``backends`` and
``methods`` solve it, ``certificate`` judges the answer without knowing how it was found, ``solve`` ties these together,
``explain`` says why there is no answer, ``comparison`` sets it beside filtering, ``report`` shows it, and
``interchange`` carries it in and out of files.
"""

from lin_freq_ocp.starting import leave_silently

leave_silently()  # before what follows, which takes a second

# isort: split
from lin_freq_ocp import library
from lin_freq_ocp.analysis.sensitivities import Sensitivities
from lin_freq_ocp.api.compare import Comparison, compare
from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.runs import SavedRun, load_run
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.api.sweep import Sweep, load_sweep, sweep
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.errors import (
    BandWarning,
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    MissingExtraError,
    NumericalError,
    ProblemError,
    SolveError,
    UnboundedError,
    UnsupportedError,
)
from lin_freq_ocp.explain.explanation import explain
from lin_freq_ocp.formulas.casadi import from_casadi
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.formulas.nodes import Formula, maximum, minimum, norm, signals
from lin_freq_ocp.interchange.cvxpy.problem import to_cvxpy
from lin_freq_ocp.interchange.problem_file.toml_file import read_problem, write_problem
from lin_freq_ocp.interchange.results.csv_file import read_csv
from lin_freq_ocp.interchange.results.mat_file import read_mat
from lin_freq_ocp.interchange.results.solution_file import SavedSolution
from lin_freq_ocp.interchange.results.solution_file import load_solution as load
from lin_freq_ocp.interchange.results.time_response import from_time_response, to_time_response
from lin_freq_ocp.methods.spectral import SpectralSolution, SpectralSolver
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import CostSum, QuadraticCost
from lin_freq_ocp.problem.dynamics.affine_mode import AffineMode
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.dynamics.smooth_pieces import SmoothPiece
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.rate_limit import rate_limited
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, Everything, Point
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.spectrum.bands import band_pass, high_pass, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, LinearConstraint, MagnitudeBound
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.certify import certify
from lin_freq_ocp.solving.explanation import Cure, Explanation
from lin_freq_ocp.solving.linear import Convex, Spectral
from lin_freq_ocp.solving.modes import BranchAndBound, Enumeration, MixedInteger
from lin_freq_ocp.solving.smooth import Nonsmooth
from lin_freq_ocp.status import Status

__version__ = "0.1.0"

__all__ = [
    "AffineMode",
    "Ball",
    "BandWarning",
    "Box",
    "BranchAndBound",
    "Certificate",
    "Comparison",
    "Convex",
    "CostSum",
    "Cure",
    "DifferentiableFunction",
    "Ellipsoid",
    "EnergyBound",
    "Enumeration",
    "Everything",
    "Explanation",
    "Formula",
    "InfeasibleError",
    "Intersection",
    "L1Cost",
    "LInfCost",
    "LimitError",
    "LinFreqOCPError",
    "LinearConstraint",
    "LinearDynamics",
    "MagnitudeBound",
    "MissingExtraError",
    "MixedInteger",
    "Multipliers",
    "Nonsmooth",
    "NumericalError",
    "OptimalControlProblem",
    "OutputSpectrum",
    "PiecewiseAffineDynamics",
    "PiecewiseSmoothDynamics",
    "Point",
    "Polyhedron",
    "ProblemError",
    "QuadraticCost",
    "Result",
    "SavedRun",
    "SavedSolution",
    "SecondOrderCone",
    "Sensitivities",
    "SmoothMode",
    "SmoothPiece",
    "Soft",
    "SolveError",
    "Spectral",
    "SpectralSolution",
    "SpectralSolver",
    "StageRows",
    "Status",
    "Sweep",
    "Trajectory",
    "UnboundedError",
    "UnsupportedError",
    "band_pass",
    "certify",
    "compare",
    "explain",
    "from_casadi",
    "from_time_response",
    "high_pass",
    "library",
    "load",
    "load_run",
    "load_sweep",
    "low_pass",
    "maximum",
    "minimum",
    "norm",
    "notch",
    "rate_limited",
    "read_csv",
    "read_mat",
    "read_problem",
    "signals",
    "simulate",
    "solve",
    "stop_band",
    "sweep",
    "to_cvxpy",
    "to_time_response",
    "write_problem",
]

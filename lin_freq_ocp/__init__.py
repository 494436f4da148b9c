"""Discrete-time optimal control with constraints in time and in frequency, with a certificate for every answer.

The names of everyday use stand here; all names stand in namespaces by subject:

``dynamics``   linear, piecewise affine, piecewise smooth
``costs``      quadratic, L1 and L-infinity
``sets``       boxes, polyhedra, balls, cones, soft constraints, joint rows
``uncertainty``  loads and plants, of which a plan must bear all
``spectrum``   bands, magnitude and energy bounds, bounds on outputs
``formulas``   signals, maximum, minimum, norm, functions of CasADi
``solvers``    the methods of ``solve``, with their options
``io``         files and other tools
``results``    what the functions return
``errors``     what they raise
``library``    benchmark problems

Nothing is imported before it is used.
"""

from lin_freq_ocp.base.interrupts import leave_silently

leave_silently()  # before the other imports: Ctrl-C during these would show a traceback

from importlib import import_module  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

from lin_freq_ocp.base import lazy_exports  # noqa: E402
from lin_freq_ocp.base.errors import answering_misspelt  # noqa: E402
from lin_freq_ocp.base.kinds import register_later  # noqa: E402

if TYPE_CHECKING:
    from lin_freq_ocp import (
        costs,
        dynamics,
        errors,
        formulas,
        io,
        library,
        results,
        sets,
        solvers,
        spectrum,
        uncertainty,
    )
    from lin_freq_ocp.api.batch import Solver, solve_many, sweep
    from lin_freq_ocp.api.compare import compare
    from lin_freq_ocp.api.generate import certify_log, generate
    from lin_freq_ocp.api.layers import to_jax, to_torch
    from lin_freq_ocp.api.minimum_time import minimum_time
    from lin_freq_ocp.api.receding_horizon import RecedingHorizon
    from lin_freq_ocp.api.shaper import shaper
    from lin_freq_ocp.api.solve import solve
    from lin_freq_ocp.costs import QuadraticCost
    from lin_freq_ocp.dynamics import (
        AffineMode,
        FrequencyResponse,
        LinearDynamics,
        PiecewiseAffineDynamics,
        PiecewiseSmoothDynamics,
    )
    from lin_freq_ocp.explanation.explanation import explain
    from lin_freq_ocp.formulas import DifferentiableFunction, from_casadi, maximum, minimum, norm, signals
    from lin_freq_ocp.io import (
        from_time_response,
        load,
        load_run,
        load_sweep,
        read_csv,
        read_mat,
        read_problem,
        to_cvxpy,
        write_problem,
    )
    from lin_freq_ocp.problem.ocp import OptimalControlProblem
    from lin_freq_ocp.results import Trajectory
    from lin_freq_ocp.sets import Box, FiniteSet, Periodic, StageRows
    from lin_freq_ocp.solvers import SpectralSolver
    from lin_freq_ocp.solving.certify import certify
    from lin_freq_ocp.spectrum import MagnitudeBound, ResidualVibration, low_pass, stop_band
    from lin_freq_ocp.transform.filtered_control import filtered_control
    from lin_freq_ocp.transform.reformulations import rate_limited
    from lin_freq_ocp.transform.simulation import simulate
    from lin_freq_ocp.uncertainty import Discs, Disturbance, Plants, robust, worst_case

__version__ = "0.1.0"

NAMESPACES = (
    *(
        "dynamics",
        "costs",
        "sets",
        "spectrum",
        "uncertainty",
        "formulas",
        "solvers",
        "io",
        "results",
        "errors",
        "library",
    ),
)

# fmt: off
_names, _import_name = lazy_exports(__name__, {
    "api.batch": "Solver solve_many sweep", "api.compare": "compare", "api.generate": "certify_log generate",
    "api.layers": "to_jax to_torch", "api.minimum_time": "minimum_time",
    "api.receding_horizon": "RecedingHorizon", "api.shaper": "shaper", "api.solve": "solve", "costs": "QuadraticCost",
    "dynamics": "AffineMode FrequencyResponse LinearDynamics PiecewiseAffineDynamics PiecewiseSmoothDynamics",
    "explanation.explanation": "explain", "formulas": "DifferentiableFunction from_casadi maximum minimum norm signals",
    "io": "from_time_response load load_run load_sweep read_csv read_mat read_problem to_cvxpy write_problem",
    "problem.ocp": "OptimalControlProblem", "transform.filtered_control": "filtered_control",
    "transform.reformulations": "rate_limited", "transform.simulation": "simulate", "results": "Trajectory",
    "sets": "Box FiniteSet Periodic StageRows", "solvers": "SpectralSolver", "solving.certify": "certify",
    "spectrum": "MagnitudeBound ResidualVibration low_pass stop_band",
    "uncertainty": "Discs Disturbance Plants robust worst_case",
}, answering_misspelt)
# fmt: on

register_later(lambda: import_module("lin_freq_ocp.solving.hybrid"))  # what has modes, kinks or levels

# fmt: off
__all__ = [
    "AffineMode", "Box", "DifferentiableFunction", "Discs", "Disturbance", "FiniteSet", "FrequencyResponse",
    "LinearDynamics", "MagnitudeBound", "OptimalControlProblem", "Periodic", "PiecewiseAffineDynamics",
    "PiecewiseSmoothDynamics", "Plants", "QuadraticCost", "RecedingHorizon", "ResidualVibration", "Solver",
    "SpectralSolver", "StageRows", "Trajectory", "certify", "certify_log", "compare", "costs", "dynamics", "errors",
    "explain", "filtered_control", "formulas", "from_casadi", "from_time_response", "generate", "io", "library", "load",
    "load_run", "load_sweep", "low_pass", "maximum", "minimum", "minimum_time", "norm", "rate_limited", "read_csv",
    "read_mat", "read_problem", "results", "robust", "sets", "shaper", "signals", "simulate", "solve", "solve_many",
    "solvers", "spectrum", "stop_band", "sweep", "to_cvxpy", "to_jax", "to_torch", "uncertainty", "worst_case",
    "write_problem",
]
# fmt: on


def __getattr__(name: str) -> Any:
    if name in NAMESPACES:
        return import_module(f"{__name__}.{name}")
    for space in () if name in _names or name.startswith("_") else NAMESPACES:
        namespace = import_module(f"{__name__}.{space}")
        if name in namespace.__all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it is lin_freq_ocp.{space}.{name}")
    return _import_name(name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]

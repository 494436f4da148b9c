"""Expression graphs: values, derivatives, interval enclosures and text. They know nothing of optimal control."""

from lin_freq_ocp.formulas.casadi import from_casadi
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.formulas.nodes import Formula, maximum, minimum, norm, signals, time_of

__all__ = ["DifferentiableFunction", "Formula", "from_casadi", "maximum", "minimum", "norm", "signals", "time_of"]

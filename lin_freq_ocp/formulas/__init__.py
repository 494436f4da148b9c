"""Expression graphs: values, derivatives, interval enclosures and text. They know nothing of optimal control.

``__all__`` lists what users may import, ``DOOR`` what other rooms and tests may, too.
"""

from lin_freq_ocp.base import lazy_exports
from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.formulas.casadi import from_casadi
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.formulas.nodes import Formula, maximum, minimum, norm, signals, time_of

# fmt: off
DOOR, __getattr__ = lazy_exports(__name__, {
    "convexity": "convex_curvature is_convex least_curvature", "jets": "interval_jets jets_of values_of",
    "intervals": "add exponential inverse multiply outward scale", "nodes": "nodes_in_order text_of",
    "operations": "OPERATIONS ScalarFunction scalar_functions",
    "text": "MOST_LEVELS formula_from_text listed_formulas read_definitions",
})
# fmt: on
__all__ = ["DifferentiableFunction", "Formula", "from_casadi", "maximum", "minimum", "norm", "signals", "time_of"]

answer_misspelt(globals())

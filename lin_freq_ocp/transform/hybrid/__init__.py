"""What is made of a problem with modes or formulas: its standard forms, smooth modes of costs, the reach of modes."""

from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.forms import FORMS
from lin_freq_ocp.transform.hybrid.priced import form_with_modes

FORMS[Dynamics] = form_with_modes

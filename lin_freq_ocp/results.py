"""What the public functions return: solutions, verdicts, comparisons, sweeps and explanations."""

from lin_freq_ocp.api.batch import Solutions, Sweep
from lin_freq_ocp.api.compare import Comparison
from lin_freq_ocp.api.minimum_time import MinimumTime
from lin_freq_ocp.api.receding_horizon import ClosedLoop
from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.runs import SavedRun
from lin_freq_ocp.api.shaper import Shaper
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.between_samples import BetweenSamples, BoundPeak
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.derivatives.derivatives import Derivative, Gradient, Side, SolutionDerivatives
from lin_freq_ocp.derivatives.recursion import Gradients
from lin_freq_ocp.derivatives.sensitivities import Sensitivities
from lin_freq_ocp.files.solution_files import SavedSolution
from lin_freq_ocp.loop.embedded import GeneratedController
from lin_freq_ocp.loop.log import CertifiedLog
from lin_freq_ocp.methods.candidate import Attempt, Reason
from lin_freq_ocp.problem.terms.quantity import Reading
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.proof.enclosure import Enclosure
from lin_freq_ocp.solving.outcome import Cure, Explanation

# fmt: off
__all__ = [
    "Attempt", "BetweenSamples", "BoundPeak", "Certificate", "CertifiedLog", "ClosedLoop", "Comparison", "Cure",
    "Derivative", "Enclosure", "Explanation", "GeneratedController", "Gradient", "Gradients", "MinimumTime",
    "Multipliers", "Reading", "Reason", "Result", "SavedRun", "SavedSolution", "Sensitivities", "Shaper", "Side",
    "SolutionDerivatives", "Solutions", "Status", "Sweep", "Trajectory",
]

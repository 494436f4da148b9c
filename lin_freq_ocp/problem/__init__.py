"""DESCRIBE: frozen descriptions of a problem and of its solutions, validated once, at construction."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "costs.quadratic": "Cost NonsmoothCost", "description": "LONGEST_FACT problem_facts",
    "dynamics.base": "Dynamics signal_labels unique_names", "dynamics.linearisation": "MOST_EVALUATIONS",
    "dynamics.measured": "read_response",
    "measures": "Measures measure one_step_residual padded_spectrum", "problem_data": "replace_fields",
    "sets.base": "ConvexSet Part", "sets.box": "end_within", "spectrum.base": "FrequencyConstraint",
    "spectrum.bands": "Band band_remarks stopped_bins time_signal",
    "terms.maps": "AffineMap JoinedMap MatrixMap OutputMap StageMap SumMap",
    "terms.penalties": "HalfSpaces LargestExcess NormBall StandardCone Within", "terms.term": "Term TermKind",
    "terms.norm_rows": "NormRows", "terms.penalty": "ConicForm HARD Penalty",
    "terms.spectrum_maps": "FrequencyMap SpectrumMap",
    "terms.semi_infinite": "Limits MagnitudeMask VibrationLimit VibrationMap ZeroOrderHoldMap ZeroOrderHoldMask "
    "limits_on peaks_above",
    "trajectory": "Extremals",
})

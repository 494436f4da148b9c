"""What a proven answer satisfies."""

import numpy as np


def assert_proven(result):
    assert result.status == "optimal"
    assert result.primal
    assert result.dual
    certificate = result.certificate
    assert certificate.pmp == "satisfied"
    assert certificate.normal
    assert certificate.worst.relative < 1e-6
    assert certificate.gap < 1e-6
    bound = certificate.bound
    outside = -np.minimum(bound.stage_gaps, 0).sum()  # a point a rounding error outside its set can gain on it
    infeasibility = abs(bound.dynamics_term) + abs(bound.frequency_term) + outside
    assert certificate.lower_bound <= result.cost + infeasibility

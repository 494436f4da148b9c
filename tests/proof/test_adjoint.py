"""The multiplier of an end, with as many digits as the adjoint of an unstable system needs."""

import numpy as np
from flint import arb, ctx

from lin_freq_ocp.proof import steer_adjoint


def given_adjoint(A, slopes):
    """Return the adjoint (T, n) of slopes (T+1, n) that is bounded, in extended precision."""
    eta = np.zeros((len(slopes) - 1, 2), dtype=np.longdouble)
    for t in range(1, len(eta)):  # both parts grow backwards
        eta[t] = np.linalg.solve(A.T, (eta[t - 1] + slopes[t]).astype(float))
    return eta.astype(float)


def test_the_adjoint_stays_near_the_given_one_over_a_growth_of_1e60():
    A, T = np.array([[2.0, 0.5], [0.0, 1.5]]), 200
    slopes = np.random.default_rng(0).normal(size=(T + 1, 2))
    eta = given_adjoint(A, slopes)
    slopes[-1] = -eta[-1]
    balls = [[arb(one) for one in row] for row in slopes.tolist()]
    with ctx.workprec(1000):
        moved, found = steer_adjoint(A, balls, eta, np.arange(2))
        _, alone = steer_adjoint(A, balls, eta, np.arange(0))
    assert np.abs(found - eta).max() < 1e-12 * np.abs(eta).max()
    assert max(abs(float(one)) for one in moved) < 1e-12
    assert np.abs(alone - eta).max() > 1e20  # the same multiplier without its last digits

"""Conjugate gradients on the kept coefficients, and what their second level is worth."""

from importlib.util import find_spec

import numpy as np
import pytest

from lin_freq_ocp.methods.structured.kkt.kept.second_level import CLIP, clip
from lin_freq_ocp.methods.structured.kkt.kept.side import KeptSide
from lin_freq_ocp.methods.structured.kkt.kept.two_level import TwoLevel
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from methods.structured.linear_systems import random_system, solved

GROWTHS = (0.0, 12.0, -5.0)


class Counted(TwoLevel):
    """The last of them is kept."""

    last = None

    def __init__(self, space):
        super().__init__(space)
        Counted.last = self


@pytest.fixture(params=["compiled", "arrays"])
def chosen(request):
    if request.param == "compiled" and find_spec("numba") is None:
        pytest.skip("numba is not installed")
    return loops(request.param == "compiled")


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("others", [False, True], ids=["bands", "all rows"])
def test_it_solves_the_system_of_a_step(chosen, seed, others):
    system = random_system(seed, GROWTHS[seed % 3], others)
    _, left = solved(KeptSide(system[0], chosen, Counted), *system)
    assert left < 1e-11
    assert max(Counted.last.iterations) <= 30


def test_restarts_hold_unstable_dynamics(chosen):
    system = random_system(3, growth=80.0, T=100)
    _, left = solved(KeptSide(system[0], chosen, TwoLevel), *system)
    assert left < 1e-9


def test_few_iterations_where_weights_differ_by_ten_orders(chosen):
    stages, Phi, C, right = random_system(1, T=120, others=False)
    rng = np.random.default_rng(0)
    active = rng.choice(120, 12, replace=False)
    Phi = np.tile(np.eye(Phi.shape[1]), (121, 1, 1))
    Phi[active, -1, -1] += 10.0 ** rng.uniform(3, 10, 12)
    Phi[active[:4], 0, 0] += 1e8
    _, left = solved(KeptSide(stages, chosen, Counted), stages, Phi, C, right)
    assert left < 1e-11
    assert max(Counted.last.iterations) <= 10


def test_clipped_weights_and_their_excess_are_the_whole():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((9, 3, 3)) * 10.0 ** rng.integers(-2, 3, size=(9, 1, 1))
    Phi, S = root @ root.swapaxes(1, 2), np.cov(rng.standard_normal((3, 50)))
    clipped, excess = clip(Phi, S)
    assert 0 < len(excess.weights) < 24
    whole = clipped.copy()
    np.add.at(whole, excess.times, excess.weights[:, None, None] * np.einsum("ka,kb->kab", *[excess.directions] * 2))
    np.testing.assert_allclose(whole, Phi, rtol=1e-9, atol=1e-9)
    L = np.linalg.cholesky(S)
    assert np.linalg.eigvalsh(L.T @ clipped[:-1] @ L).max() <= CLIP * (1 + 1e-6)

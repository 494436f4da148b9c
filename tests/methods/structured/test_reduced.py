"""Conjugate gradients on the kept coefficients, and what their second level is worth."""

import numpy as np
import pytest

from helpers.seeds import seeds
from lin_freq_ocp.methods.structured import CLIP, LEAST_REST, NullSpaceSolver, TwoLevel, can_compile, clip, loops
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
    if request.param == "compiled" and not can_compile():
        pytest.skip("no C compiler")
    return loops(request.param == "compiled")


@pytest.mark.parametrize("seed", seeds(range(12)))
@pytest.mark.parametrize("others", [False, True], ids=["bands", "all rows"])
def test_it_solves_the_system_of_a_step(chosen, seed, others):
    system = random_system(seed, GROWTHS[seed % 3], others)
    _, left = solved(NullSpaceSolver(system[0], chosen, Counted), *system)
    assert left < 1e-11
    assert max(Counted.last.iterations) <= 30


def test_restarts_hold_unstable_dynamics(chosen):
    system = random_system(3, growth=80.0, T=100)
    _, left = solved(NullSpaceSolver(system[0], chosen, TwoLevel), *system)
    assert left < 1e-9


def test_few_iterations_where_weights_differ_by_ten_orders(chosen):
    stages, Phi, C, right = random_system(1, T=120, others=False)
    rng = np.random.default_rng(0)
    active = rng.choice(120, 12, replace=False)
    Phi = np.tile(np.eye(Phi.shape[1]), (121, 1, 1))
    Phi[active, -1, -1] += 10.0 ** rng.uniform(3, 10, 12)
    Phi[active[:4], 0, 0] += 1e8
    _, left = solved(NullSpaceSolver(stages, chosen, Counted), stages, Phi, C, right)
    assert left < 1e-11
    assert max(Counted.last.iterations) <= 10


def test_clipped_weights_and_their_excess_are_the_whole():
    rng = np.random.default_rng(2)
    Phi = np.tile(np.diag([1.0, 1e-3, 2.0]), (9, 1, 1))
    rows = rng.standard_normal((9, 3))
    Phi += np.einsum("t,ta,tb->tab", 10.0 ** rng.integers(-2, 5, 9), rows, rows)
    S = np.cov(rng.standard_normal((3, 50)))
    clipped, excess = clip(Phi, S)
    assert 0 < len(excess.weights) < 24
    whole = clipped.copy()
    np.add.at(whole, excess.times, np.einsum("k,ka,kb->kab", excess.weights, excess.directions, excess.directions))
    np.testing.assert_allclose(whole, Phi, rtol=1e-9, atol=1e-9)
    seen = np.linalg.eigvalsh(clipped[:-1] @ S)
    assert seen.max() <= 3 * (1 + LEAST_REST) * CLIP
    assert np.linalg.eigvalsh(clipped).min() > 0


def test_the_largest_excesses_are_chosen():
    Phi = np.einsum("t,ab->tab", 10.0 ** np.arange(9), np.eye(2))
    clipped, excess = clip(Phi, np.eye(2), 4)
    assert sorted(excess.times) == [6, 6, 7, 7]
    np.testing.assert_allclose(clipped[:6], Phi[:6])


def test_weights_of_single_entries_do_not_touch_the_digits_of_others():
    Phi = np.tile(np.array([[2.0, 1.0, 0.0], [1.0, 3.0, 1e-6], [0.0, 1e-6, 1e-9]]), (3, 1, 1))
    Phi[0, 0, 0], Phi[0, 1, 1] = 1e14, 1e12
    clipped, excess = clip(Phi, np.diag([1.0, 1.0, 1e-8]))
    assert len(excess.weights) == 2
    np.testing.assert_allclose(clipped[0, 2, 2], 1e-9, rtol=1e-6)

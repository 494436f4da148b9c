"""The layers for PyTorch and JAX; without these packages, the error that names the extra."""

from __future__ import annotations

import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.layers import NAMES as NAMES_OF_SAMPLE
from helpers.checks.layers import apart, by_derivatives
from helpers.seeds import expensive, seeds
from lin_freq_ocp.api import Layer
from lin_freq_ocp.derivatives import SolutionDerivatives

T = 10
PROBLEM = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[0.9, 0.3], [-0.2, 0.85]], [[0.1], [1.0]]),
    T,
    lfo.QuadraticCost(Q=1.0, R=0.2, P=2.0, x_ref=[1.0, 0.0]),
    initial_state=[0.5, -0.2],
    control_set=lfo.Box(-0.3, 0.3),
    control_spectrum=lfo.stop_band(bins=[3]),
)
NAMES = ("A", "B", "Q", "R", "x_ref", "initial_state", "control_upper")
A, B = PROBLEM.dynamics.A, PROBLEM.dynamics.B
VALUES = (A, B, PROBLEM.cost.Q, PROBLEM.cost.R, PROBLEM.cost.x_ref, PROBLEM.initial_state.lower, np.array([0.3]))


@pytest.mark.parametrize(("make", "package"), [(lfo.to_torch, "torch"), (lfo.to_jax, "jax")])
def test_an_absent_package_is_named(monkeypatch, make, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(lfo.errors.MissingExtraError, match=rf"to_{package}: {package} is not installed.*\[{package}\]"):
        make(PROBLEM, ["A"])


@expensive
def test_no_package_is_imported_unasked():
    code = "import sys, lin_freq_ocp as lfo; lfo.solve(lfo.library.double_integrator()).derivatives.vjp()"
    code += "; assert not {'torch', 'jax'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


HOW_TO = Path(lfo.__file__).parents[1] / "docs" / "how_to"
RECORDED = Path(__file__).with_name("layers.npz")  # by scripts/verify.py --part layers --save


@pytest.mark.parametrize("seed", seeds(range(6), always=[0]))
@pytest.mark.parametrize("package", ["torch", "jax"])
def test_recorded_gradients_of_layers_are_those_of_derivatives(package, seed):
    with np.load(RECORDED) as file:
        first = f"{package}/{seed}/"
        found = {name.removeprefix(first): file[name] for name in file if name.startswith(first)}
    assert {*NAMES_OF_SAMPLE} <= {*found}
    assert apart(found, by_derivatives(seed)) < 1e-8


def test_a_second_derivative_moves_the_optimum_once(monkeypatch):
    moves, layer = list[str](), Layer(PROBLEM, ("x_ref", "initial_state"), "error")
    jvp = SolutionDerivatives.jvp

    def counted(derivatives, **change):
        moves.extend(change)
        return jvp(derivatives, **change)

    monkeypatch.setattr(SolutionDerivatives, "jvp", counted)
    data, change = [np.array([1.0, 0.0]), np.array([0.5, -0.2])], [np.array([1.0, 0.0]), np.zeros(2)]
    of_weight, *found = layer.cost_curvatures(data, np.array(2.0), change)
    assert moves == ["x_ref", "initial_state"]
    known = lfo.solve(PROBLEM).derivatives
    curved = known.prices_along(x_ref=[1.0, 0.0])
    assert of_weight == pytest.approx(known.prices["x_ref"][0])
    for name, one in zip(("x_ref", "initial_state"), found, strict=True):
        np.testing.assert_allclose(one, 2 * curved[name], rtol=1e-10)


class TestTorch:
    @pytest.fixture
    def torch(self):
        return pytest.importorskip("torch")

    def test_gradients_are_differences(self, torch):
        layer = lfo.to_torch(PROBLEM, NAMES)
        tensors = [torch.tensor(np.array(value), requires_grad=True) for value in VALUES]

        def symmetric(*given):
            A, B, Q, R, *others = given
            return layer(A, B, 0.5 * (Q + Q.mT), R, *others)

        assert torch.autograd.gradcheck(symmetric, tensors, eps=1e-5, atol=1e-4, rtol=1e-4)

    def test_the_cost_has_second_derivatives(self, torch):
        names = tuple(name for name in NAMES if name != "R")
        layer = lfo.to_torch(PROBLEM, names)
        tensors = [
            torch.tensor(np.array(v), requires_grad=True) for n, v in zip(NAMES, VALUES, strict=True) if n != "R"
        ]

        def cost(*given):
            A, B, Q, *others = given
            return layer(A, B, 0.5 * (Q + Q.mT), *others)[2]

        assert torch.autograd.gradgradcheck(cost, tensors, eps=1e-5, atol=1e-4, rtol=1e-4)
        (slope,) = torch.autograd.grad(layer(*tensors)[1].sum(), tensors[:1], create_graph=True)
        with pytest.raises(RuntimeError, match="once_differentiable"):
            slope.sum().backward()

    def test_a_batch_of_states(self, torch):
        layer = lfo.to_torch(PROBLEM, ["A", "initial_state"])
        starts = torch.tensor([[0.5, -0.2], [0.3, 0.1]], dtype=torch.float64, requires_grad=True)
        plant = torch.tensor(np.array(A), requires_grad=True)
        x, u, cost = layer(plant, starts)
        assert (x.shape, u.shape, cost.shape) == ((2, T + 1, 2), (2, T, 1), (2,))
        (cost.sum() + (u**2).sum()).backward()
        each = [lfo.solve(PROBLEM.with_ends(start)).derivatives for start in starts.detach().numpy()]
        of_A = sum(one.vjp(u=2 * one.trajectory.u)["A"] + one.prices["A"] for one in each)
        np.testing.assert_allclose(plant.grad.numpy(), of_A, rtol=1e-9)
        assert starts.grad.shape == (2, 2)

    def test_a_kink_raises_or_takes_a_side(self, torch):
        free = lfo.solve(replace(PROBLEM, control_set=None)).derivatives.trajectory.u
        bounds = np.full((T, 1), 9.0)
        bounds[4] = free[4]
        problem = replace(PROBLEM, control_set=lfo.Box(-9.0, bounds))
        start = torch.tensor([0.5, -0.2], dtype=torch.float64, requires_grad=True)
        with pytest.raises(lfo.errors.NoDerivativeError, match="active with multiplier zero") as caught:
            lfo.to_torch(problem, ["initial_state"])(start)[1].sum().backward()
        assert caught.value.rows == ("control set, t = 4, component 0, upper",)
        lfo.to_torch(problem, ["initial_state"], kinks="right")(start)[1].sum().backward()
        known = lfo.solve(replace(problem, control_set=None)).derivatives.vjp(u=np.ones((T, 1)))
        np.testing.assert_allclose(start.grad.numpy(), known["initial_state"], rtol=1e-8)

    @expensive
    def test_the_page_on_learning_learns(self, torch, capsys):
        runpy.run_path(str(HOW_TO / "learn_a_cost.py"))
        said = capsys.readouterr().out
        assert said == "load 4.96 (5), load speed 0.496 (0.5), target 0.400 m (0.4)\n"
        assert said.strip() in (HOW_TO / "learn.md").read_text(encoding="utf-8")


class TestJax:
    @pytest.fixture
    def jax(self):
        jax = pytest.importorskip("jax")
        jax.config.update("jax_enable_x64", True)
        return jax

    def test_gradients_under_jit_and_vmap(self, jax):
        layer = lfo.to_jax(PROBLEM, ["A", "initial_state"])
        weights = np.random.default_rng(0).standard_normal((T, 1))

        def loss(A, start):
            x, u, cost = layer(A, start)
            return (weights * u).sum() + (x**2).sum() + 0.1 * cost

        start = jax.numpy.array([0.5, -0.2])
        of_A, of_start = jax.jit(jax.grad(loss, argnums=(0, 1)))(jax.numpy.array(A), start)
        d = lfo.solve(PROBLEM).derivatives
        known = d.vjp(x=2 * d.trajectory.x, u=weights)
        for name, found in (("A", of_A), ("initial_state", of_start)):
            np.testing.assert_allclose(found, known[name] + 0.1 * d.prices[name], rtol=1e-9)
        many = jax.vmap(jax.grad(loss, argnums=1), in_axes=(None, 0))(
            jax.numpy.array(A), jax.numpy.stack([start, start])
        )
        np.testing.assert_allclose(many[1], of_start, rtol=1e-12)


@pytest.mark.parametrize("make", [lfo.to_torch, lfo.to_jax])
def test_bad_calls(make):
    pytest.importorskip(make.__name__.removeprefix("to_"))
    with pytest.raises(lfo.errors.ProblemError, match="the datum 'Z'"):
        make(PROBLEM, ["Z"])
    with pytest.raises(lfo.errors.ProblemError, match="kinks: got 'left'"):
        make(PROBLEM, ["A"], kinks="left")

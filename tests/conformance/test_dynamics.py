"""The suite of dynamics: the recursion, its standard form, its tangents and what is derived from it, of every class."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.instances import classes_of
from helpers.instances.dynamics import INSTANCES, T
from helpers.seeds import seeds
from lin_freq_ocp.problem import Dynamics

DERIVED = {"StandardDynamics", "ModesWithCost"}  # a base class, and dynamics with a cost, which a reformulation makes
ROUNDING = 1e-11

each_kind = pytest.mark.parametrize("name", INSTANCES)


def recursion(dynamics: Dynamics, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the images of x_t and u_t, (T, n)."""
    step = dynamics.stepper(T)
    return np.array([step(t, x[t], u[t]) for t in range(T)])


def images(dynamics: Dynamics, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return x_1 .. x_T of controls, (T, n), where each x_t is known or follows from the controls."""
    return dynamics.successors(x, u) if is_response(dynamics) else recursion(dynamics, x, u)


def is_response(dynamics: Dynamics) -> bool:
    return dynamics.response(T) is not None


def test_every_class_of_the_package_is_here():
    classes = {type(part) for one in INSTANCES.values() for part in (one.dynamics, one.problem.form)}
    assert {kind.__name__ for kind in classes_of(Dynamics) - classes} == DERIVED


@each_kind
def test_simulations_and_the_standard_form_have_the_states_of_the_definition(name):
    instance, problem = INSTANCES[name], INSTANCES[name].problem
    form, standard = problem.form, problem.form.standard_form
    np.testing.assert_allclose(lfo.simulate(problem, instance.u).x, instance.x, rtol=ROUNDING, atol=ROUNDING)
    if not is_response(form):
        np.testing.assert_allclose(recursion(standard, instance.x, instance.u), instance.x[1:], atol=ROUNDING)
    assert standard.standard_form is standard
    for field in ("state_dim", "control_dim", "state_names", "control_names", "mode_names", "affine"):
        assert getattr(standard, field) == getattr(form, field)
    same = replace(problem, dynamics=replace(instance.dynamics))
    np.testing.assert_array_equal(lfo.simulate(same, instance.u).x, lfo.simulate(problem, instance.u).x)


@pytest.mark.parametrize("name", seeds(INSTANCES))
def test_the_judge_accepts_a_simulation_and_no_other_trajectory(name):
    instance = INSTANCES[name]
    moved = instance.x + 1e-3 * (np.arange(T + 1) == 3)[:, None]
    assert lfo.certify(instance.problem, lfo.Trajectory(instance.x, instance.u)).feasible
    assert not lfo.certify(instance.problem, lfo.Trajectory(moved, instance.u)).feasible


@each_kind
def test_linear_dynamics_along_a_trajectory_are_its_tangents(name):
    """To first order: a tenth of a change has a hundredth of the error. Controls that modes determine do not change."""
    instance, rng = INSTANCES[name], np.random.default_rng(1)
    form, x, u = instance.problem.form, instance.x, instance.u
    dx, du = rng.standard_normal(x.shape), rng.standard_normal(u.shape) * instance.moves
    tangent, affine = form.linear_at(x, u), form.affine_at(x, u)
    np.testing.assert_allclose(tangent.successors(x, u), x[1:], atol=ROUNDING)
    eta = rng.standard_normal(x[1:].shape)
    change = tangent.successors(dx, du) - tangent.successors(0 * dx, 0 * du)
    of_z, dz = tangent.pull_back(eta), np.hstack([dx[:-1], du])
    assert (eta * change).sum() == pytest.approx((of_z * dz).sum(), rel=1e-10)
    assert (np.abs(tangent.successors(dx, du)) <= tangent.successor_sizes(dx, du) * (1 + ROUNDING)).all()
    assert (np.abs(of_z) <= tangent.pulled_sizes(eta) * (1 + ROUNDING) + ROUNDING).all()
    if is_response(form):
        return
    np.testing.assert_allclose((eta * change).sum(1), (of_z * dz).sum(1), rtol=1e-10)
    np.testing.assert_allclose(recursion(affine, x, u), x[1:], atol=ROUNDING)
    for along in (tangent, affine):
        errors = [
            np.abs(recursion(along, x + h * dx, u + h * du) - recursion(form, x + h * dx, u + h * du)).max()
            for h in (1e-3, 1e-4)
        ]
        assert errors[1] <= max(0.02 * errors[0], ROUNDING)
    of_x, of_u, constants = form.gains_along(x, u)
    for A, B, _ in map(tangent.at, range(T)):
        assert (np.abs(A) <= of_x + ROUNDING).all()
        assert (np.abs(B) <= of_u + ROUNDING).all()
    assert [part.shape for part in form.gains()] == [of_x.shape, of_u.shape, constants.shape]


@each_kind
def test_modes_of_a_trajectory_are_known_by_their_names(name):
    instance, form = INSTANCES[name], INSTANCES[name].problem.form
    sequence = form.sequence_of(instance.x, instance.u)
    assert sequence.shape == (T,)
    assert 0 <= sequence.min() <= sequence.max() < max(len(form.mode_names), 1)
    assert len(set(form.mode_names)) == len(form.mode_names)
    if form.affine and form.mode_names:
        fixed = instance.problem.with_modes(sequence)
        np.testing.assert_allclose(lfo.simulate(fixed, instance.u).x, instance.x, atol=ROUNDING)
        assert all((rows.slack(instance.x, instance.u) >= -ROUNDING).all() for rows in fixed.stage_rows)


@each_kind
def test_derived_dynamics_are_those_of_the_given_ones(name):
    """Translated ones, those with further states, and those with a known disturbance."""
    instance, rng = INSTANCES[name], np.random.default_rng(3)
    dynamics, form, x, u = instance.dynamics, instance.problem.form, instance.x, instance.u
    origin, moved = np.linspace(-2.0, 3.0, x.shape[1]), form.translated(np.linspace(-2.0, 3.0, x.shape[1]), T)
    assert (moved is not None) == instance.has_no_zero
    if moved is not None:
        assert moved.mode_names == form.mode_names
        np.testing.assert_allclose(images(moved, x - origin, u) + origin, x[1:], atol=ROUNDING)
    F, G, w = rng.standard_normal((2, 2)), rng.standard_normal((2, u.shape[1])), [np.zeros(2)]
    if is_response(form):  # its further outputs have no recursion
        F = 0.0 * F
    for control in u:
        w.append(F @ w[-1] + G @ control)
    longer, both = form.augmented(F, G, ["w_0", "w_1"], T), np.hstack([x, np.array(w)])
    assert longer.state_names == (*form.state_names, "w_0", "w_1")
    if is_response(form):
        of_longer = lfo.OptimalControlProblem(longer, T, lfo.QuadraticCost(R=1.0))
        np.testing.assert_allclose(lfo.simulate(of_longer, u).x[1:], both[1:], atol=ROUNDING)
    else:
        np.testing.assert_allclose(recursion(longer, both, u), both[1:], atol=ROUNDING)
    push = np.arange(x[1:].size, dtype=float).reshape(x[1:].shape)
    if isinstance(dynamics, lfo.LinearDynamics):
        np.testing.assert_allclose(recursion(dynamics.disturbed(push), x, u), x[1:] + push, atol=ROUNDING)
    else:
        with pytest.raises(lfo.errors.UnsupportedError, match="a preview needs linear dynamics"):
            dynamics.disturbed(push)


@pytest.mark.parametrize("name", seeds(INSTANCES))
def test_it_describes_itself_and_is_saved(name, tmp_path):
    instance = INSTANCES[name]
    dynamics, problem = instance.dynamics, instance.problem
    facts = dynamics.facts([*dynamics.state_names, *dynamics.control_names])
    assert facts
    assert all(title in dynamics._repr_html_() for title, _ in facts)
    lfo.write_problem(problem, tmp_path / "problem.toml")
    again = lfo.read_problem(tmp_path / "problem.toml")
    simulated = lfo.simulate(again, instance.u)
    np.testing.assert_allclose(simulated.x, instance.x, rtol=ROUNDING, atol=ROUNDING)
    assert type(again.dynamics) in (type(dynamics), type(dynamics.standard_form))

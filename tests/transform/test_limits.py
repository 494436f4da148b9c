"""The limits of a problem: each gives way, each number moves what it says, also of classes defined here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.own_kinds import SteadyGain
from helpers.seeds import expensive
from lin_freq_ocp.testing import check_terms
from lin_freq_ocp.transform import all_limits, changed_fields, constraints, numbers

T = 12
PLANT = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]], state_names=["position [m]", "speed [m/s]"])


class Stubborn(SteadyGain):
    """A constraint whose limit falls where it should rise."""

    def at_levels(self, levels):
        return Stubborn(0.5 * self.limit)


def problem(**fields):
    given = {
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": lfo.Box(-2, 2),
        "initial_state": [0.0, 0.0],
        "terminal_state": [1.0, 0.0],
    }
    return lfo.OptimalControlProblem(PLANT, T, **(given | fields))


RICH = problem(
    control_set=lfo.Box(-2, 2) & lfo.sets.Ball(1.9),
    state_set=lfo.Box([None, -0.5], [3.0, 0.9]),
    stage_rows=[lfo.StageRows([[0.0, 1.0]], None, [0.8], name="speed limit")],
    control_spectrum=[lfo.stop_band(bins=[6]), lfo.MagnitudeBound(5.0, bins=[3]), SteadyGain(4.0)],
    state_spectrum=lfo.spectrum.EnergyBound(90.0, bins=[2], component=1),
    output_spectrum=lfo.spectrum.OutputSpectrum(None, [[1.0]], lfo.MagnitudeBound(7.0, bins=[4], penalty=2.0)),
)


def test_every_constraint_is_a_limit_and_soft_ones_have_numbers_only():
    assert [limit.name for limit in constraints(RICH)] == [
        "initial state",
        "terminal state",
        "state bound on position [m]",
        "state bound on speed [m/s]",
        "control bound on u_0",
        "row 0 of speed limit",
        "control stop band on u_0",
        "control set",
        "energy bound on speed [m/s]",
        "mask on u_0",
        "steady gain of u_0",
    ]
    assert sorted(numbers(RICH)) == [
        "bound.0",
        "initial_state.0",
        "initial_state.1",
        "level.control_spectrum.1",
        "level.control_spectrum.2",
        "level.output_spectrum.0.0",
        "level.state_spectrum.0",
        "rows.0",
        "state_lower.1",
        "state_upper.0",
        "state_upper.1",
        "terminal_state.0",
        "terminal_state.1",
    ]


def test_a_limit_without_amount_stays_and_without_end_is_gone():
    for limit in constraints(RICH):
        relaxed = limit.relaxed(RICH, 0.0)
        assert [one.name for one in constraints(relaxed)] == [one.name for one in constraints(RICH)]
        without = {one.name for one in constraints(limit.relaxed(RICH, np.inf))}
        stays = {limit.name} if limit.name.startswith("row ") else set()  # with limits that are infinite
        assert without == {one.name for one in constraints(RICH)} - {limit.name} | stays


def test_numbers_move_the_fields_that_they_name():
    moved = replace(RICH, **changed_fields(RICH, {"bound.0": 1.5, "rows.0": 0.7, "level.control_spectrum.2": -20.0}))
    assert moved.control_tube.upper.max() == 1.5
    assert moved.stage_rows[0].e == pytest.approx([0.7])
    assert moved.control_spectrum[2].limit == pytest.approx(0.4)
    assert numbers(moved)["bound.0"].value == 1.5
    assert moved.control_set.members == RICH.control_set.members
    with pytest.raises(lfo.errors.ProblemError, match=r"bound\.1: got no number of that name"):
        changed_fields(RICH, {"bound.1": 1.0})


def test_bounds_that_depend_on_time_give_way_and_have_no_number():
    upper = np.linspace(1.0, 2.0, T)[:, None]
    given = problem(control_set=lfo.Box(-upper, upper))
    bound = next(limit for limit in all_limits(given) if limit.name == "control bound on u_0")
    assert bound.relaxed(given, 0.5).control_tube.upper == pytest.approx(upper + 0.5)
    assert "bound.0" not in numbers(given)


@expensive
def test_a_class_of_ones_own_is_explained_moved_and_checked():
    impossible = problem(control_spectrum=SteadyGain(0.1), initial_state=[0.0, 0.0], terminal_state=[1.0, 1.0])
    explanation = lfo.explain(impossible)
    assert "steady gain of u_0" in explanation.family
    cures = {cure.block: cure.words for cure in explanation.cures}
    assert cures["steady gain of u_0"].startswith("limit 0.1 -> 2")
    assert lfo.solve(replace(impossible, control_spectrum=SteadyGain(2.01))).status == "optimal"
    assert check_terms(RICH) == []


def test_a_limit_that_moves_the_wrong_way_is_told():
    faults = check_terms(problem(control_spectrum=Stubborn(4.0)))
    assert "steady gain of u_0: it is violated more after it is relaxed" in faults
    assert "level.control_spectrum.0: it is another one at its own value" in faults

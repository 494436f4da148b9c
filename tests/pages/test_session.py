"""The answers of a live page against lfo.solve, and what can be moved."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.pages import Session, points


@pytest.fixture(scope="module")
def session():
    return Session(lfo.library.pendulum(), lambda horizon: lfo.library.pendulum(horizon=horizon))


def of(session, key):
    return next(slider for slider in session.sliders if slider.key == key)


def double_integrator(**parameters):
    return lfo.library.double_integrator(**parameters)


@pytest.fixture(scope="module")
def integrator():
    return Session(double_integrator(), lambda horizon: double_integrator(horizon=horizon))


@pytest.mark.parametrize("notch", [0, -3, 2])
def test_every_answer_is_that_of_solve(integrator, notch):
    cutoff, bound, start = (of(integrator, key) for key in ("cutoff", "bound.0", "initial_state.0"))
    values = {"cutoff": cutoff.notch(notch), "bound.0": bound.notch(notch), "initial_state.0": start.notch(notch)}
    state = np.array(integrator.problem.initial_box.lower)
    state[0] = values["initial_state.0"]
    limit = values["bound.0"]
    problem = double_integrator(cutoff_hz=values["cutoff"], control_bound=limit, initial_state=state.tolist())
    result, answer = lfo.solve(problem), integrator.answer(values)
    assert answer["status"] == result.status == "optimal"
    assert answer["cost"] == pytest.approx(result.cost, rel=1e-6)
    assert answer["lower_bound"] == pytest.approx(result.lower_bound, rel=1e-6)
    assert answer["gap"] < 1e-6
    assert answer["theorem"] == "satisfied, normal"
    np.testing.assert_allclose(answer["trajectory"]["signals"][0], result.trajectory.u[:, 0], atol=1e-3 * limit)
    size = np.abs(result.trajectory.x[:, 0]).max()
    np.testing.assert_allclose(answer["trajectory"]["signals"][1], result.trajectory.x[:, 0], atol=1e-3 * size)
    spectrum = np.abs(np.fft.rfft(result.trajectory.u[:, 0]))
    np.testing.assert_allclose(answer["trajectory"]["spectra"][0], spectrum, atol=1e-3 * spectrum.max())
    assert answer["frame"]["signals"][0]["upper"] == [pytest.approx(limit, rel=1e-3)]
    last_kept = max(k for k in range(len(spectrum)) if not result.problem.control_stop[k, 0])
    assert answer["frame"]["spectra"][0]["stopped"][0][0] == pytest.approx(
        (last_kept + 0.5) * answer["frame"]["spectra"][0]["step"]
    )


def test_the_horizon_is_built_anew(integrator):
    horizon = of(integrator, "horizon").notch(5)
    answer = integrator.answer({"horizon": horizon})
    assert len(answer["trajectory"]["signals"][0]) == answer["frame"]["horizon"] == horizon
    assert answer["cost"] == pytest.approx(lfo.solve(double_integrator(horizon=int(horizon))).cost, rel=1e-6)


def test_the_last_notch_of_the_cutoff_is_none(integrator):
    high = of(integrator, "cutoff").high
    assert high >= 0.5 / integrator.problem.sampling_time
    answer = integrator.answer({"cutoff": high})
    assert answer["frame"]["spectra"][0]["stopped"] == []
    assert integrator.compare({"cutoff": high}) == {"finding": "", "trajectories": []}


def test_beside_are_the_classical_and_the_filtered_trajectory(integrator):
    comparison = lfo.compare(double_integrator(), ["brickwall"])
    classical, filtered = integrator.compare({})["trajectories"]
    assert [classical["name"], filtered["name"]] == ["classical", "filtered"]
    np.testing.assert_allclose(classical["signals"][0], comparison.classical.trajectory.u[:, 0], rtol=1e-3, atol=1e-6)
    replay = comparison.filtered[0].replay.trajectory
    np.testing.assert_allclose(filtered["signals"][1], replay.x[:, 0], rtol=1e-2, atol=1e-4)
    assert "misses the end" in integrator.compare({})["finding"]


def test_an_infeasible_setting_names_the_conflict_and_its_least_cure(integrator):
    cutoff = of(integrator, "cutoff")
    given = {"cutoff": cutoff.low}
    answer = integrator.answer(given)
    assert answer["status"] == "infeasible"
    assert answer["trajectory"] is None
    assert any("stop band" in block for block in answer["conflict"])
    cure = integrator.cure(given, "cutoff")
    assert integrator.answer({"cutoff": cure["value"]})["status"] == "optimal"
    less = cutoff.notch(round((cure["value"] - cutoff.value) / cutoff.step) - 1)
    assert integrator.answer({"cutoff": less})["status"] == "infeasible"
    assert integrator.cure(given, "initial_state.1") == {"key": "initial_state.1", "value": None}


def test_a_cure_that_nobody_waits_for_ends_early(integrator):
    given = {"cutoff": of(integrator, "cutoff").low}
    assert integrator.cure(given, "cutoff", lambda: False)["value"] == of(integrator, "cutoff").high


def test_all_notches_include_the_own_value_and_both_ends(session):
    assert [slider.key for slider in session.sliders][:3] == ["cutoff", "bound.0", "horizon"]
    for slider in session.sliders:
        for end in (slider.low, slider.high):
            assert (end - slider.value) / slider.step == pytest.approx(round((end - slider.value) / slider.step))
        assert slider.low <= slider.value <= slider.high
    assert of(session, "cutoff").value == pytest.approx(40)  # Hz, of 0.8 pi rad/sample at 100 Hz
    assert of(session, "terminal_state.0").unit == "m"


def test_bounds_that_are_not_symmetric_have_two_sliders():
    session = Session(lfo.library.quadcopter())
    keys = [slider.key for slider in session.sliders]
    assert {"lower.0", "upper.0"} <= set(keys)
    assert "horizon" not in keys
    upper = of(session, "upper.0")
    bound = session.answer({"upper.0": upper.notch(-5)})["frame"]["signals"][0]["upper"]
    assert bound == [pytest.approx(upper.notch(-5), rel=1e-3)]


def test_other_limits_than_a_low_pass_have_no_cutoff():
    assert "cutoff" not in [slider.key for slider in Session(lfo.library.crane()).sliders]


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ([], "values"),
        ({"cutof": 1}, "values.cutof"),
        ({"cutoff": "1"}, "values.cutoff"),
        ({"cutoff": float("nan")}, "values.cutoff"),
        ({"cutoff": True}, "values.cutoff"),
        ({"cutoff": 1e9}, "values.cutoff"),
    ],
)
def test_wrong_values_are_refused_by_name(session, values, field):
    with pytest.raises(ProblemError) as raised:
        session.answer(values)
    assert raised.value.field == field


def test_dynamics_with_modes_are_refused_with_words():
    with pytest.raises(UnsupportedError, match="sweep --grid"):
        Session(lfo.library.cart_between_walls())


def test_the_sweep_of_a_static_page_is_on_notches_without_repetitions(session):
    grid = points(session.sliders)
    assert len({tuple(values.items()) for values in grid}) == len(grid) < 200
    assert {slider.key: slider.value for slider in session.sliders} in grid
    for slider in session.sliders:
        assert len({values[slider.key] for values in grid}) >= 3


@expensive
def test_a_residual_vibration_is_drawn_with_its_limit():
    session = Session(lfo.library.printer_move())
    answer = session.answer({})
    (panel,), (values,) = answer["frame"]["vibrations"], answer["trajectory"]["vibrations"]
    at, low, high = np.array(panel["at"]), *panel["box"]
    within = (at >= low) & (at <= high)
    assert panel["limit"] == session.problem.control_spectrum.limit
    assert np.array(values)[within].max() == pytest.approx(panel["limit"], rel=1e-2)
    assert np.array(values).max() > panel["top"]
    (classical,) = session.compare({})["trajectories"][0]["vibrations"]
    assert np.array(classical)[within].max() > 10 * panel["limit"]

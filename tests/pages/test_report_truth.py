"""Headlines say no more than status, certificate and spectrum do; filters and figures show what the problem asks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex

import lin_freq_ocp as lfo
from lin_freq_ocp.comparison import apply_filter, filter_limits, filter_stop
from lin_freq_ocp.pages import (
    REFERENCE,
    certificate_table,
    comparison_data,
    comparison_rows,
    finding_of,
    parts_of_the_gap,
    spectra_figure,
    states_figure,
    tiles,
    verdict,
)

T = 24


def problem(**fields: Any) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics(
        [[1, 0.1], [0, 1]],
        [[0.005, 0], [0.1, 0.1]],
        sampling_time=0.1,
        state_names=["x [m]", "V"],
        control_names=["u", "I [A]"],
    )
    given = {"cost": lfo.QuadraticCost(R=1), "initial_state": [0, 0], "terminal_state": [1, 0]} | fields
    return lfo.OptimalControlProblem(dynamics, T, **given)


@cache
def worse_between_the_bins() -> lfo.results.Comparison:
    """A notch that is empty at its bins, and fuller than before between them."""
    return lfo.compare(problem(control_spectrum=lfo.stop_band(bins=[1, 2])), filters=["brickwall"])


def with_status(comparison: lfo.results.Comparison, status: str, kind: str = "rigorous") -> lfo.results.Comparison:
    result = comparison.constrained
    assert result.certificate is not None
    assert result.certificate.bound is not None
    bound = replace(result.certificate.bound, kind=kind)
    certificate = replace(result.certificate, bound=bound)
    return replace(comparison, constrained=replace(result, status=status, certificate=certificate))


def everything_said(comparison: lfo.results.Comparison) -> str:
    certificate = comparison.constrained.certificate
    assert certificate is not None
    parts = [str(finding_of(comparison)), str(tiles(comparison)), *verdict(certificate, comparison.problem)]
    table = certificate_table(comparison.problem, certificate).title
    return " ".join([*parts, str(table), parts_of_the_gap(certificate)]).lower()


# --- headlines ------------------------------------------------------------------------------------------------------


def test_a_higher_peak_between_the_bins_is_in_the_headline():
    comparison = worse_between_the_bins()
    free, own = comparison.classical_measures.stopband_peak, comparison.constrained_measures.stopband_peak
    assert own > 1.1 * free
    said = finding_of(comparison).solution
    assert "all constraints hold" not in said
    assert f"peaks at {own:.3g} between the bins" in said
    assert f"above the {free:.3g} without" in said


def test_only_what_is_proven_is_called_optimal():
    proven = with_status(worse_between_the_bins(), "optimal")
    assert "proven optimal within" in everything_said(proven)
    local = with_status(worse_between_the_bins(), "locally_optimal", "numerical")
    said = everything_said(local)
    assert "locally optimal as far as the maximum principle says, not proven optimal" in said
    assert "proven optimal within" not in said
    assert "global lower bound" not in said
    assert "gap to the global" not in said
    assert "no other trajectory" not in said
    assert "gap to the numerical bound" in said
    stopped = everything_said(with_status(worse_between_the_bins(), "limit", "numerical"))
    assert "ended with: limit" in stopped
    assert "locally optimal" not in stopped


@pytest.mark.parametrize(
    ("status", "label"), [("optimal", "optimal"), ("locally_optimal", "locally optimal"), ("limit", "best point")]
)
def test_a_solution_alone_is_called_by_its_status(status: str, label: str):
    comparison = with_status(lfo.compare(problem(), filters=[]), status)
    assert [entry.label for entry in comparison.trajectories] == [label]
    assert [trace.label for trace in comparison_data(comparison).traces] == [label]
    assert comparison_rows(comparison).columns == (label,)
    tile = {"optimal": ("optimal cost", "")}.get(status, ("cost found", "not proven global"))
    assert (tiles(comparison)[0][0], tiles(comparison)[0][2]) == tile


# --- filters --------------------------------------------------------------------------------------------------------


def test_a_band_on_one_control_leaves_the_others_as_they_are():
    one = problem(control_spectrum=lfo.low_pass(cutoff_hz=1.0, component="I"))
    noise = np.random.default_rng(1).normal(size=(T, 2))
    for name in ("brickwall", "butterworth", "zero_phase", "moving_average"):
        result = apply_filter(name, one, noise)
        assert result.u[:, 0] == pytest.approx(noise[:, 0])
        assert np.abs(result.u[:, 1] - noise[:, 1]).max() > 0.1
    assert "Hz" in apply_filter("butterworth", one, noise).description
    assert "rad/sample" not in apply_filter("butterworth", one, noise).description
    assert filter_limits(one) == ""


OUTPUT = lfo.spectrum.OutputSpectrum(C=[[1, 1]], constraints=lfo.MagnitudeBound(3.0, bins=[5, 6]), output_names=["tip"])


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"state_spectrum": lfo.stop_band(bins=[5], component=1)}, "the band is on states, on which filters of"),
        ({"output_spectrum": OUTPUT}, "the band is on outputs, on which filters of"),
        ({"control_spectrum": lfo.stop_band(bins=[9]), "output_spectrum": OUTPUT}, "bands on outputs are not filtered"),
        (
            {"control_spectrum": lfo.spectrum.LinearConstraint(np.ones((T, 1, 2)))},
            "filters do not act on linear equations over all times",
        ),
    ],
)
def test_the_page_says_what_filters_do_not_act_on(fields: dict[str, Any], said: str):
    comparison = lfo.compare(problem(terminal_state=None, **fields), filters=["brickwall"])
    assert said in finding_of(comparison).filtering
    assert finding_of(comparison).setting == "With the constraint in the problem"
    labels = [entry.label for entry in comparison.trajectories]
    if filter_stop(comparison.problem).any():
        assert labels == ["classical", "brickwall", "constrained"]
    else:
        assert labels == ["classical", "constrained"]
        assert finding_of(comparison).filtering.startswith("does not apply")


# --- figures --------------------------------------------------------------------------------------------------------

TRACK = np.column_stack([np.sin(np.linspace(0, 3, T + 1)), np.zeros(T + 1)])


@cache
def tracking() -> lfo.results.Comparison:
    return lfo.compare(
        problem(
            cost=lfo.QuadraticCost(Q=np.diag([5.0, 0.0]), R=0.1, x_ref=TRACK)
            + lfo.costs.L1Cost(u=[0, 0.1], u_ref=[0, 0.7]),
            state_set=lfo.sets.Soft(lfo.Box([-0.9, -50], [0.9, 50]), 3.0),
            stage_rows=lfo.StageRows([[0, 0]], [[0, 2]], [3.0], "limit"),
            terminal_state=None,
            control_spectrum=[
                lfo.MagnitudeBound(4.0, band=lfo.low_pass(cutoff_hz=3.0), component=0),
                lfo.MagnitudeBound(5.0, bins=[2, 3], component=1, penalty=2.0),
            ],
            output_spectrum=OUTPUT,
        ),
        filters=[],
    )


def lines(ax: Any) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), dtype=float) for line in ax.lines]


def holds(ax: Any, level: float) -> bool:
    return bool(at_level(ax, level))


def at_level(ax: Any, level: float) -> list[Any]:
    """Return the lines that are of one value everywhere."""
    return [line for line in ax.lines if len(line.get_ydata()) > 1 and np.allclose(line.get_ydata(), level)]


def test_references_and_soft_bounds_are_drawn():
    figure = states_figure(comparison_data(tracking()))
    position, speed = figure.axes
    shapes = [line[:-1] for line in lines(position) if len(line) == T + 1]
    assert any(np.allclose(shape, TRACK[:-1, 0]) for shape in shapes)  # at the end no deviation costs anything
    assert holds(position, 0.9)
    assert holds(position, -0.9)
    assert REFERENCE not in [to_hex(line.get_color()) for line in speed.lines]  # its deviation costs nothing
    low, high = position.get_ylim()
    assert low < TRACK[:, 0].min()
    assert high > TRACK[:, 0].max()
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"soft bound", "reference"} <= set(texts)


def test_controls_have_references_and_bounds_of_rows():
    figure = tracking().constrained.plot()
    current = next(ax for ax in figure.axes if ax.get_ylabel() == "I [A]")
    assert holds(current, 0.7)
    assert holds(current, 1.5)
    assert not any(holds(ax, 0.7) for ax in figure.axes if ax.get_ylabel() == "u")


def test_levels_of_masks_are_drawn_at_their_bins():
    axes = tracking().constrained.plot().axes
    spectra = {ax.get_ylabel(): ax for ax in axes if ax.get_ylabel().startswith("|DFT")}
    (hard,) = at_level(spectra["|DFT of u|"], 4.0)
    bins = np.arange(T // 2 + 1) / (0.1 * T)
    assert hard.get_xdata() == pytest.approx(bins[bins > 3.0 + 1e-9])
    (soft,) = at_level(spectra["|DFT of I| [A]"], 5.0)
    assert soft.get_xdata() == pytest.approx(bins[2:4])
    assert soft.get_linestyle() != hard.get_linestyle()


def test_outputs_have_their_spectra():
    comparison = tracking()
    (ax,) = spectra_figure(data := comparison_data(comparison), data.outputs).axes
    assert holds(ax, 3.0)
    y = comparison.constrained.trajectory.x.sum(axis=1)
    bins = np.abs(np.fft.rfft(y))
    drawn = np.concatenate([np.asarray(line.get_ydata()) for line in ax.lines])
    assert np.isin(np.round(bins[:5], 9), np.round(drawn, 9)).all()


def test_names_keep_their_case():
    titles = [ax.get_title(loc="left") for ax in tracking().constrained.plot().axes]
    assert "(a) u" in titles
    assert "(c) I" in titles
    assert any(title.endswith(" x and V") for title in titles)


def test_many_states_share_panels():
    n = 20
    names = [f"mass {i} [m]" for i in range(11)] + [f"speed {i} [m/s]" for i in range(9)]
    dynamics = lfo.LinearDynamics(0.9 * np.eye(n) + 0.1 * np.eye(n, k=1), np.eye(n)[:, -1:], state_names=names)
    found = lfo.solve(lfo.OptimalControlProblem(dynamics, 10, lfo.QuadraticCost(Q=1, R=1), initial_state=np.ones(n)))
    axes = found.plot().axes
    shared = [ax for ax in axes if ax.get_legend() is not None]
    assert len(shared) == 4
    labels = [text.get_text() for ax in shared for text in ax.get_legend().get_texts()]
    assert labels == [name.split(" [")[0] for name in names]
    assert {ax.get_ylabel() for ax in shared} == {"[m]", "[m/s]"}

"""The figure of a sweep."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from helpers.sweeps import SHORT


def test_the_figure_shows_costs_relative_to_none_and_what_is_infeasible(serial):
    (ax,) = serial.plot().axes
    costs = {
        row["parameters"]["cutoff_hz"]: row["cost"] for row in serial.rows if row["parameters"]["control_bound"] == 1
    }
    drawn = [line.get_ydata() for line in ax.lines if line.get_label() == "control_bound = 1"]
    np.testing.assert_allclose(drawn[0], [np.nan, *(costs[x] / costs[None] for x in (1.0, 3.0))])
    assert "relative" in ax.get_ylabel()
    assert ax.get_title(loc="left") == "double_integrator: the price of bandwidth"
    crosses = [list(line.get_xdata()) for line in ax.lines if line.get_marker() == "x"]
    infeasible = [row["parameters"]["cutoff_hz"] for row in serial.rows if row["status"] == "infeasible"]
    assert sorted(x for one in crosses for x in one) == sorted(x for x in infeasible if x is not None)
    for line in ax.lines:
        if line.get_marker() == "x" and len(line.get_xdata()):  # above every cost, and not among the cheapest
            marks = ax.transAxes.inverted().transform(ax.get_xaxis_transform().transform(line.get_xydata()))[:, 1]
            highest = ax.transAxes.inverted().transform(ax.transData.transform([(1, np.nanmax(drawn[0]))]))[0, 1]
            assert (marks > highest).all()


@expensive
def test_figures_of_other_sweeps_are_drawn(tmp_path):
    found = lfo.sweep(
        SHORT, {"horizon": [-1, 40, 60, 2000], "speed_bound": [0.3, None]}, tolerance=10, method="spectral"
    )
    figure = found.plot()
    (ax,) = figure.axes
    assert ax.get_xscale() == "log" or found.column("status")[0] == "error"
    figure.savefig(tmp_path / "sweep.svg")
    with pytest.raises(lfo.errors.ProblemError, match="no parameter with numbers"):
        lfo.sweep(SHORT, {"terminal_state": [[1.0, 0.0]]}).plot()


def test_a_point_that_breaks_constraints_has_no_cost():
    found = lfo.sweep(SHORT, {"horizon": [30, 60]}, tolerance=10, method="spectral")
    broken, good = found.rows
    assert broken["status"] == "numerical_error"
    assert (broken["cost"], broken["gap"]) == (None, None)
    assert "breaks constraints" in broken["message"]
    assert good["cost"] is not None
    (ax,) = found.plot().axes
    assert [line.get_label() for line in ax.lines if line.get_marker() == "$?$" and not len(line.get_xdata())]
    assert np.isnan(ax.lines[0].get_ydata()[0])

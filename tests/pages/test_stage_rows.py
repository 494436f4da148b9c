"""Joint rows in measures, tables and pages."""

from __future__ import annotations

import json

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compared_pages import blanks
from helpers.stage_rows import cart
from lin_freq_ocp.files import comparison_summary
from lin_freq_ocp.pages import comparison_rows, finding_of, render_page
from lin_freq_ocp.problem import measure, problem_facts


def test_violations_are_measured_and_shown():
    """At least 0.45 at t = 5, which the brick wall, smoothing the start, misses."""
    e = [[0.55, -0.45 if t == 5 else np.inf] for t in range(24)]
    rows = lfo.StageRows([[0.0, 1.0], [0.0, -1.0]], [[0.05], [-0.05]], e, name="traction [N]")
    problem = cart(stage_rows=rows, control_spectrum=lfo.stop_band(bins=range(4, 13)))
    comparison = lfo.compare(problem, filters=["brickwall"])
    assert comparison.classical_measures.stage_violation < 1e-8
    brick_wall = comparison.filtered[0].replay.measures
    x, u = comparison.filtered[0].replay.trajectory.x, comparison.filtered[0].replay.trajectory.u
    excess = 0.45 - x[5, 1] - 0.05 * u[5, 0]
    assert brick_wall.stage_violation == pytest.approx(excess)
    assert excess > 1e-3
    assert measure(cart(), comparison.classical.trajectory).stage_violation is None
    summary = json.loads(json.dumps(comparison_summary(comparison)))
    assert summary["filtered"]["brickwall"]["stage_violation"] == pytest.approx(excess)
    group = next(group for group in comparison_rows(comparison).groups if group.title == "Violates the joint rows by")
    (row,) = group.rows
    assert (row.label, row.unit) == ("traction", "N")
    assert [cell.passed for cell in row.cells] == [True, False, True]
    assert float(row.cells[1].text) == pytest.approx(excess, rel=1e-3)
    assert "violates traction by" in str(finding_of(comparison))
    assert ("rows: traction [N]", "2 rows C x + D u ≤ e, which depend on time") in problem_facts(problem)
    conditions = [one for one in comparison.constrained.certificate.conditions if one.label == "S-z"]
    assert conditions[0].name == "rows hold: traction [N]"
    page = render_page(comparison, blanks())
    assert "rows hold: traction" in page
    assert "S-z and N-z: joint rows" in page
    without = lfo.compare(cart(), filters=[])
    assert "that joint rows hold" not in render_page(without, blanks())

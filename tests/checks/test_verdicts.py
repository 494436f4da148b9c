"""The record of verdicts that are close to their tolerance."""

from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.verdicts import LISTED, Record, close_verdicts, closeness, list_close_verdicts


@pytest.fixture(scope="module")
def certificate():
    return lfo.solve(lfo.library.double_integrator(horizon=20, terminal_state=None, cutoff_hz=None)).certificate


def with_residual(certificate, ratio):
    """Return the certificate with one residual, in units of its tolerance, and the others zero."""
    conditions = [replace(one, residual=0.0) for one in certificate.conditions]
    state = next(i for i, one in enumerate(conditions) if one.name == "state equation")
    conditions[state] = replace(
        conditions[state], residual=ratio * conditions[state].tolerance * conditions[state].scale
    )
    return replace(certificate, conditions=tuple(conditions))


@pytest.mark.parametrize(("ratio", "close"), [(0.85, 0.85), (1.25, 0.8), (1e-3, 1e-3), (1e6, 1e-6)])
def test_a_residual_is_close_to_its_tolerance_from_both_sides(certificate, ratio, close):
    assert closeness(ratio) == pytest.approx(close)
    principle, feasible = close_verdicts(with_residual(certificate, ratio))[:2]
    assert principle.closeness == feasible.closeness == pytest.approx(close)
    assert principle.subject == "C-iii state equation"


def test_a_record_keeps_the_closest_verdict(certificate):
    record = Record()
    for ratio in (0.2, 0.7, 0.4):
        record.add(with_residual(certificate, ratio))
    assert record.closest.closeness == pytest.approx(0.7)


def test_close_verdicts_are_listed_the_closest_first():
    lines = list_close_verdicts({"far": (LISTED / 2, "a"), "near": (0.5, "b"), "nearest": (0.9, "c")})
    assert [line.split()[-2] for line in lines] == ["nearest:", "near:"]

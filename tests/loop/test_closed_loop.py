"""What frequency constraints of a loop say about the applied signal, and what they do not."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.loops import pendulum


def test_a_constraint_of_each_plan_is_named():
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_spectrum: holds for each plan.*Spectrogram"):
        lfo.RecedingHorizon(pendulum(20))


def test_windows_and_plain_loops_are_silent():
    quiet = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0)), length=10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lfo.RecedingHorizon(pendulum(20, None))
        lfo.RecedingHorizon(replace(pendulum(20, None), control_spectrum=quiet))


def test_the_page_says_it_and_what_is_not_judged(tmp_path):
    loop = lfo.RecedingHorizon(pendulum(20), certify="later")
    log = loop.run(np.array([0.02, 0.0, 0.0, 0.0]), 6)
    page = log.save(tmp_path).read_text()
    assert "nothing follows for the applied signal" in page
    assert "not judged" in page
    assert "not judged" not in (loop.certify().save(tmp_path)).read_text()

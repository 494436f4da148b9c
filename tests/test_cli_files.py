"""Problem files on the command line: what --set changes, and what solve writes beside its answer."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_cli import run

import lin_freq_ocp as lfo


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """Return the path of the template: a cart with a low pass of 20 Hz, sampled at 100 Hz."""
    path = tmp_path_factory.mktemp("cart") / "cart.toml"
    assert run("init", str(path))[0] == 0
    return path


# --- settings -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["cutoff_hz", "cutoff"])
def test_a_cut_off_is_set_in_a_file_as_it_is_in_a_sweep(cart, key):
    value = 3.0 if key == "cutoff_hz" else 2 * np.pi * 3.0 * 0.01
    expected = lfo.sweep(lfo.read_problem(cart), {key: [value]}).rows[0]["cost"]
    for command in ("solve", "compare"):
        status, out, _ = run(command, str(cart), "--set", f"{key}={value}", "--json")
        assert status == 0
        assert json.loads(out)["cost"] == pytest.approx(expected, rel=1e-9)
    assert json.loads(run("solve", str(cart), "--json")[1])["cost"] < 0.999 * expected


def test_without_a_cut_off_the_file_has_no_frequency_constraint(cart):
    status, out, _ = run("solve", str(cart), "--json", "--set", 'cutoff_hz="none"')
    assert status == 0
    assert json.loads(out)["cost"] == pytest.approx(12 / 2 / 0.01**4 / (199 * 200 * 201), rel=1e-6)  # rest to rest


def test_certify_judges_under_the_cut_off_that_is_set(cart, tmp_path):
    saved = str(tmp_path / "run.npz")
    assert run("solve", str(cart), "--set", "cutoff_hz=3", "--save", saved)[0] == 0
    assert run("certify", str(cart), saved, "--set", "cutoff_hz=3")[0] == 0
    status, out, _ = run("certify", str(cart), saved, "--set", "cutoff_hz=2", "--json")
    failed = {one["label"] for one in json.loads(out)["certificate"]["conditions"] if not one["passed"]}
    assert (status, failed & {"C-vii"}) == (3, {"C-vii"})


def test_a_grid_takes_precedence_over_a_cut_off_that_is_set(cart):
    status, out, _ = run("sweep", str(cart), "--set", "cutoff=0.3", "--grid", "cutoff_hz=[3.0]", "--json")
    assert status == 0
    alone = json.loads(run("solve", str(cart), "--set", "cutoff_hz=3", "--json")[1])
    assert json.loads(out)["rows"][0]["cost"] == pytest.approx(alone["cost"], rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("bogus=1",), ("cart.toml: bogus: got an unknown key", "horizon", "cutoff, cutoff_hz", "control_set.upper")),
        (("cutof_hz=1",), ("Did you mean 'cutoff_hz'?",)),
        (("cost.RR=1",), ("cost.RR", "one of Q, R, S", "Did you mean 'R'?")),
        (("cutoff=1", "cutoff_hz=5"), ("cutoff_hz: got cutoff, too", "Both set the same")),
        (("control_spectrum=[]", "cutoff=1"), ("cutoff: got control_spectrum, too",)),
        (("cutoff_hz='fast'",), ("cart.toml: control_spectrum[0].cutoff",)),
    ],
)
def test_a_setting_that_a_file_does_not_know_is_refused(cart, settings, words):
    given = [word for one in settings for word in ("--set", one)]
    for arguments in (("solve", str(cart)), ("compare", str(cart)), ("sweep", str(cart), "--grid", "horizon=[100]")):
        status, out, err = run(*arguments, *given)
        assert (status, out) == (2, "")
        for word in words:
            assert word in err


def test_two_cut_offs_are_no_grid(cart):
    status, _, err = run("sweep", str(cart), "--grid", "cutoff=[0.3]", "--grid", "cutoff_hz=[2.0]")
    assert (status, "--grid cutoff_hz: got cutoff, too" in err) == (2, True)

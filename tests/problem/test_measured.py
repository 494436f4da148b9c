"""Measured responses: interpolation at bins, CSV files, python-control, and what is refused."""

import re

import control
import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.base.errors import ProblemError

TABLE = [[0.0, 1.0, 0.0], [0.25, 0.0, -1.0], [0.5, 2.0, 3.0]]  # Hz


def test_both_parts_are_linear_between_frequencies(tmp_path):
    by_table = lfo.FrequencyResponse.from_table(TABLE, samples=8, sampling_time=1.0)
    assert by_table.G[:, 0, 0].tolist() == [1, 0.5 - 0.5j, -1j, 1 + 1j, 2]  # the real part at the Nyquist frequency
    file = tmp_path / "plant.csv"
    file.write_text("# measured\nfrequency,real,imaginary\n" + "\n".join(",".join(map(str, row)) for row in TABLE))
    by_file = lfo.FrequencyResponse.from_csv(file, 8, 1.0, mode="zero-padded", state_names=["y"])
    assert np.array_equal(by_file.G, by_table.G)
    assert (by_file.mode, by_file.state_names) == ("zero-padded", ("y",))


def test_a_response_of_python_control():
    omega = 2 * np.pi * np.linspace(0, 0.5, 9)
    plant = control.frd(control.tf([1.0], [1.0, -0.5], 1.0), omega, inputs="force", outputs="speed")
    dynamics = lfo.FrequencyResponse.from_frd(plant, samples=16, sampling_time=1.0)
    assert np.allclose(dynamics.G[:, 0, 0], 1 / (np.exp(1j * omega) - 0.5))
    assert (dynamics.state_names, dynamics.control_names) == (("speed",), ("force",))
    with pytest.raises(ProblemError, match="plant: got TransferFunction"):
        lfo.FrequencyResponse.from_frd(control.tf([1.0], [1.0, -0.5], 1.0), samples=16)


def test_bins_outside_are_named_or_zero():
    message = r"frequencies from 0.1 to 0.3 Hz; expected all bins .* Not covered: bins 0 \(0 Hz\), 3 \(0.375 Hz\)"
    with pytest.raises(ProblemError, match=message):
        lfo.FrequencyResponse.from_table([[0.1, 1, 1], [0.3, 1, 1]], samples=8, sampling_time=1.0)
    found = lfo.FrequencyResponse.from_table([[0.1, 1, 1], [0.3, 1, 1]], 8, 1.0, outside="zero").G[:, 0, 0]
    assert found.tolist() == [0, 1 + 1j, 1 + 1j, 0, 0]


@pytest.mark.parametrize(
    ("table", "named", "message"),
    [
        ([[0.0, 1.0], [1.0, 1.0]], {}, "dynamics.table: got shape (2, 2)"),
        ([[0.5, 1, 0], [0.0, 1, 0]], {}, "each above the one before"),
        ([[0.0, 1, 0]], {}, "at least two frequencies"),
        ([[0.0, 1, 1], [0.5, 1, 0]], {}, "expected a real response at frequency 0"),
        (TABLE, {"outside": "hold"}, "outside: got 'hold'; expected 'refuse' or 'zero'"),
        (TABLE, {"samples": 0}, "samples: got 0"),
    ],
)
def test_bad_tables_are_named(table, named, message):
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.FrequencyResponse.from_table(table, **({"samples": 8, "sampling_time": 1.0} | named))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f,re,im\n0,1\n", "plant.csv: row 1: got '0,1'; expected three finite numbers"),
        ("0,1,0\nx,1,0\n", "plant.csv: row 1: got 'x,1,0'"),
        ("f,re,im\n", "plant.csv: got no rows"),
    ],
)
def test_bad_files_are_named(tmp_path, text, message):
    (tmp_path / "plant.csv").write_text(text)
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.FrequencyResponse.from_csv(tmp_path / "plant.csv", 8, 1.0)
    with pytest.raises(ProblemError, match="a readable CSV file"):
        lfo.FrequencyResponse.from_csv(tmp_path / "none.csv", 8, 1.0)

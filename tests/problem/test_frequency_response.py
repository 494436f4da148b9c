"""FrequencyResponse: outputs against convolution, its adjoint, rate limits, measured tables, and refused input."""

import re
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError, UnsupportedError

MODES = ["periodic", "zero-padded"]


def random_response(rng, horizon, p, m, mode, **named):
    """Return a response of random kernels that decay, and the kernels of one record (N, p, m)."""
    N = horizon if mode == "periodic" else 2 * horizon
    kernel = rng.standard_normal((N, p, m)) * np.exp(-np.arange(N) / 3)[:, None, None]
    return lfo.FrequencyResponse(np.fft.rfft(kernel, axis=0), mode=mode, **named), kernel


@pytest.mark.parametrize("mode", MODES)
def test_the_adjoint_and_the_matrix_are_those_of_the_response(mode):
    rng = np.random.default_rng(1)
    dynamics, _ = random_response(rng, 7, 2, 3, mode)
    response, u, w = dynamics.response(7), rng.standard_normal((7, 3)), rng.standard_normal((8, 2))
    assert np.isclose((w * response.linear(u)).sum(), (response.pull_back(w) * u).sum(), rtol=1e-13)
    assert np.allclose(response.matrix @ u.ravel(), response.linear(u).ravel(), rtol=0, atol=1e-13)


def test_known_outputs_add_up():
    t = np.arange(8)
    offset = np.zeros(5, dtype=complex)
    offset[1] = 3.0 * 8 / 2  # 3 cos(2 pi t / 8)
    dynamics = lfo.FrequencyResponse(np.ones(5), offset=offset, disturbance=0.1 * t)
    x = lfo.simulate(lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(R=1.0)), np.ones((8, 1))).x[:, 0]
    assert np.allclose(x[:-1], 1 + 3 * np.cos(2 * np.pi * t / 8) + 0.1 * t)
    assert x[-1] == x[0]


def test_rate_limits_hold_around_the_period():
    dynamics = lfo.FrequencyResponse(np.ones(5))
    reference = np.array([1.0, 1, 1, 1, 1, 1, 1, -1, 1])[:, None]
    problem = lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(Q=1.0, R=1e-3, x_ref=reference))
    result = lfo.solve(lfo.rate_limited(problem, 0.5))
    assert result.certificate.globally_optimal
    change = np.diff(np.append(result.trajectory.u, result.trajectory.u[0]))
    assert np.abs(change).max() == pytest.approx(0.5, abs=1e-8)
    assert np.abs(change[-1]) == pytest.approx(0.5, abs=1e-8)


def test_replace_makes_the_same_with_other_values():
    dynamics = lfo.FrequencyResponse(np.ones(5), 0.5, state_names=["y"], control_names=["v"])
    other = replace(dynamics, G=2 * np.ones(5))
    assert (other.sampling_time, other.state_names, float(other.G[0, 0, 0].real)) == (0.5, ("y",), 2.0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"G": np.ones((5, 2))}, r"dynamics.G: got shape (5, 2)"),
        ({"G": [1.0]}, "dynamics.G: got shape (1,)"),
        ({"G": [1.0, np.nan, 1.0]}, "dynamics.G[1]: got (nan+0j)"),
        ({"G": "none"}, "dynamics.G: got 'none'"),
        ({"G": [1j, 1.0, 1.0]}, "dynamics.G[0]: got imaginary part 1; expected a real response at frequency 0"),
        ({"G": np.ones(5), "mode": "open"}, "dynamics.mode: got 'open'; expected 'periodic' or 'zero-padded'"),
        ({"G": np.ones(5), "offset": np.ones(4)}, "dynamics.offset: got shape (4, 1); expected shape (5, 1)"),
        ({"G": np.ones(5), "offset": [1j, 0, 0, 0, 0]}, "dynamics.offset[0]: got imaginary part 1"),
        ({"G": np.ones(5), "disturbance": np.ones((8, 2))}, "dynamics.disturbance: got shape (8, 2)"),
        ({"G": np.ones(5), "sampling_time": 0.0}, "dynamics.sampling_time"),
    ],
)
def test_bad_data_are_named(fields, message):
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.FrequencyResponse(**fields)


@pytest.mark.parametrize(
    ("dynamics", "message"),
    [
        (lfo.FrequencyResponse(np.ones(6)), "dynamics.G: got 6 bins; expected 5 bins, 0 .. 4 of a record of 8 samples"),
        (lfo.FrequencyResponse(np.ones(5), mode="zero-padded"), "expected 9 bins, 0 .. 8 of a record of 16 samples"),
        (
            lfo.FrequencyResponse([1, 1, 1, 1, 1j]),
            "dynamics.G[4]: got imaginary part 1; expected a real response at the",
        ),
        (lfo.FrequencyResponse(np.ones(5), disturbance=np.ones(9)), "dynamics.disturbance: got 9 times; expected 8"),
    ],
)
def test_data_of_another_record_are_named(dynamics, message):
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(R=1.0))


def test_what_a_period_says_already_is_refused():
    dynamics, cost = lfo.FrequencyResponse(np.ones(5)), lfo.QuadraticCost(R=1.0)
    with pytest.raises(ProblemError, match="terminal_state: got periodic ends; expected none with a periodic"):
        lfo.OptimalControlProblem(dynamics, 8, cost, terminal_state=lfo.Periodic())
    with pytest.raises(ProblemError, match=r"initial_state: got .* expected None for a FrequencyResponse"):
        lfo.simulate(lfo.OptimalControlProblem(dynamics, 8, cost), np.ones((8, 1)), [0.0])


def test_methods_that_step_refuse_with_words():
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(5)), 8, lfo.QuadraticCost(R=1.0))
    with pytest.raises(UnsupportedError, match="structured"):
        lfo.solve(problem, method="structured")


def test_a_record_whose_matrix_does_not_fit_is_refused():
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(200_001)), 400_000, lfo.QuadraticCost(R=1.0))
    with pytest.raises(UnsupportedError, match="coefficients of the bins that controls pass"):
        lfo.solve(problem, method="convex")


TABLE = [[0.0, 1.0, 0.0], [0.25, 0.0, -1.0], [0.5, 2.0, 3.0]]  # Hz


def test_both_parts_are_linear_between_frequencies(tmp_path):
    by_table = lfo.FrequencyResponse.from_table(TABLE, samples=8, sampling_time=1.0)
    assert by_table.G[:, 0, 0].tolist() == [1, 0.5 - 0.5j, -1j, 1 + 1j, 2]  # the real part at the Nyquist frequency
    file = tmp_path / "plant.csv"
    file.write_text("# measured\nfrequency,real,imaginary\n" + "\n".join(",".join(map(str, row)) for row in TABLE))
    by_file = lfo.FrequencyResponse.from_csv(file, 8, 1.0, mode="zero-padded", state_names=["y"])
    assert np.array_equal(by_file.G, by_table.G)
    assert (by_file.mode, by_file.state_names) == ("zero-padded", ("y",))


def test_samples_and_sampling_time_that_a_file_does_not_have_are_asked_for(tmp_path):
    file = tmp_path / "plant.csv"
    file.write_text("\n".join(",".join(map(str, row)) for row in TABLE))
    with pytest.raises(ProblemError, match=r"seconds per step of the problem\. The table ends at 0.5 Hz, .* of 1 s"):
        lfo.FrequencyResponse.from_csv(file)
    with pytest.raises(ProblemError, match="the horizon, twice the horizon if zero-padded"):
        lfo.FrequencyResponse.from_csv(file, sampling_time=1.0)


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
        ("f,re,im\n0,1\n", "plant.csv: row 1: got '0,1'; expected 3 finite numbers"),
        ("0,1,0\nx,1,0\n", "plant.csv: row 1: got 'x,1,0'"),
        ("f,re,im\n", "plant.csv: got no rows"),
        ("f,re\n0,1\n1,1\n", "The imaginary part is missing."),
        ("f,|G|,angle\n0,1,0\n1,1,0\n", "plant.csv: header: got 'angle'"),
        ("w [rad/s],re,im\n0,1,0\n1,1,0\n", "frequencies from 0 to 0.159155 Hz; expected all bins of the record"),
    ],
)
def test_bad_files_are_named(tmp_path, text, message):
    (tmp_path / "plant.csv").write_text(text)
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.FrequencyResponse.from_csv(tmp_path / "plant.csv", 8, 1.0)
    with pytest.raises(ProblemError, match="got no such file"):
        lfo.FrequencyResponse.from_csv(tmp_path / "none.csv", 8, 1.0)
    with pytest.raises(ProblemError, match="got not a regular file"):  # which would never end
        lfo.FrequencyResponse.from_csv(Path("/dev/zero"), 8, 1.0)

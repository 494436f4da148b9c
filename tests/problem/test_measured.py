"""Plants in files of others: headers of responses, and matrices that MATLAB saved."""

import re

import numpy as np
import pytest
from scipy.io import savemat

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import read_response

RE_IM = [[1.5, 2.0, -3.0], [2.5, -1.0, 0.5]]


def table(form, separator=",", decimal="."):
    """Return the rows of RE_IM in another form, as a file has them."""
    values = np.array(RE_IM)
    G = values[:, 1] + 1j * values[:, 2]
    frequency = {"Hz": values[:, 0], "rad/s": 2 * np.pi * values[:, 0], "kHz": values[:, 0] / 1e3}
    columns = {
        **{f"frequency [{unit}]": given for unit, given in frequency.items()},
        "re": G.real,
        "im": G.imag,
        "magnitude": abs(G),
        "magnitude [dB]": 20 * np.log10(abs(G)),
        "phase [deg]": np.degrees(np.angle(G)),
        "phase [rad]": np.angle(G),
        "coherence": np.array([0.9, 1.0]),
    }
    rows = np.column_stack([columns[name] for name in form])
    lines = [separator.join(repr(float(number)).replace(".", decimal) for number in row) for row in rows]
    return "\n".join([separator.join(form), *lines, ""])


@pytest.mark.parametrize(
    "form",
    [
        ("frequency [Hz]", "re", "im"),
        ("im", "frequency [Hz]", "re"),
        ("frequency [rad/s]", "re", "im", "coherence"),
        ("frequency [kHz]", "magnitude", "phase [rad]"),
        ("frequency [Hz]", "magnitude [dB]", "phase [deg]"),
        ("coherence", "frequency [rad/s]", "magnitude [dB]", "phase [rad]"),
    ],
)
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_a_response_is_what_its_header_says(tmp_path, form, separator, decimal):
    (tmp_path / "frf.csv").write_text(table(form, separator, decimal))
    found, coherence = np.split(read_response(tmp_path / "frf.csv"), [3], axis=1)
    assert found == pytest.approx(np.array(RE_IM), rel=1e-12)
    assert coherence.tolist() == ([[0.9], [1.0]] if "coherence" in form else [[], []])


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("f [Hz], |G(jw)| [dB], arg G(jw) [deg]\n1,20,90\n", [1, 0, 10]),
        ("f_hz\tmag_db\tphase_deg\n1\t0\t180\n", [1, -1, 0]),
        ('"Frequency (Hz)";"Magnitude (dB)";"Phase (°)"\n"1,5";"-20,0";"0,0"\n', [1.5, 0.1, 0]),
        ("% frequency [Hz] magnitude phase [deg]\n1 2 180\n", [1, -2, 0]),
        ("# measured on Monday\n1,2,3\n", [1, 2, 3]),
        ("\ufefff,re,im\n1,2,3\n", [1, 2, 3]),
        ("1 2 3\n2 3 4\n", [1, 2, 3]),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_headers_of_analysers_and_spreadsheets(tmp_path, text, first, encoding):
    unmarked = text.removeprefix("\ufeff") if encoding == "utf-16" else text  # which has a mark of its own
    (tmp_path / "frf.csv").write_bytes(unmarked.encode("utf-8" if "\ufeff" in unmarked else encoding))
    assert read_response(tmp_path / "frf.csv")[0] == pytest.approx(first, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0,0\n10,-20,-1.5\n", "frf.csv: header: got none; expected 'frequency [Hz],re,im' or 'frequency [Hz],magn"),
        ("0,1,0\n10,0.1,-90\n", "frf.csv: header: got none; expected 'frequency [Hz],re,im' or 'frequency [Hz],magn"),
        (
            "f,gain,phase\n1,2,3\n",
            "header: got 'phase'; expected a phase with its unit: 'phase [deg]' or 'phase [rad]'",
        ),
        ("omega,re,im\n1,2,3\n", "header: got 'omega'; expected a frequency with its unit, [Hz] or [rad/s]"),
        ("f,gain,phase [rad]\n0,1,0\n1,-3,0\n", "row 2: got the magnitude -3; expected zero or above. Is it in dB?"),
        ("f,re,im,noise\n1,2,3,4\n", "header: got 'noise'; expected names of columns"),
        ("f,re,phase [deg]\n1,2,3\n", "header: got 'f, re, phase [deg]'; expected the columns of one response"),
        ("f,re,im\n1,5,0,1,2,5\n", "row 1: got '1,5,0,1,2,5'; expected 3 finite numbers: frequency, re, im. With dec"),
        ("f,re,im\n1,2,nan\n", "row 1: got '1,2,nan'"),
        ("# f,re,im\n", "frf.csv: got no rows"),
    ],
)
def test_what_a_file_leaves_open_is_asked(tmp_path, text, message):
    (tmp_path / "frf.csv").write_text(text)
    with pytest.raises(ProblemError, match=re.escape(message)):
        read_response(tmp_path / "frf.csv")


A, B = [[0.0, 1.0], [-4.0, -0.1]], [[0.0], [1.0]]


def cells(*texts):
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = texts
    return column


NAMES = {"StateName": cells("angle", "speed"), "StateUnit": cells("rad", ""), "InputName": cells("torque")}


@pytest.mark.parametrize("place", ["variables", "structure"])
@pytest.mark.parametrize("keys", [("A", "B", "Ts"), ("a", "b", "ts")])
def test_a_plant_that_matlab_saved(tmp_path, place, keys):
    fields = (
        dict(zip(keys, (A, B, 0.01), strict=True)) | {"C": np.eye(2), "E": np.zeros((0, 0)), "InputDelay": 0.0} | NAMES
    )
    savemat(tmp_path / "plant.mat", fields if place == "variables" else {"sys": fields, "note": "by hand"})
    dynamics = lfo.LinearDynamics.from_mat(tmp_path / "plant.mat")
    assert (dynamics.A.tolist(), dynamics.B.tolist(), dynamics.sampling_time) == (A, B, 0.01)
    assert (dynamics.state_names, dynamics.control_names) == (("angle [rad]", "speed"), ("torque",))
    named = lfo.LinearDynamics.from_mat(tmp_path / "plant.mat", state_names=["p", "q"])
    assert named.state_names == ("p", "q")


def test_a_continuous_plant_is_sampled(tmp_path):
    savemat(tmp_path / "plant.mat", {"A": A, "B": B, "Ts": 0})
    dynamics = lfo.LinearDynamics.from_mat(tmp_path / "plant.mat", 0.1)
    assert (dynamics.A == lfo.LinearDynamics.from_continuous(A, B, 0.1).A).all()
    assert dynamics.plant is not None


PLANT = {"A": A, "B": B, "Ts": 0.01}


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"x": 1.0}, "plant.mat: got the variables x; expected the matrices A and B, and Ts"),
        ({"one": PLANT, "two": PLANT}, "plant.mat: got the plants one, two; expected"),
        ({"A": A, "B": B}, "plant.mat: Ts: got nothing; expected seconds per step, or 0 for a continuous plant"),
        ({"s": {"B": B, "Ts": 0.1}}, "plant.mat: s.A: got nothing"),
        (PLANT | {"Ts": -1.0}, "plant.mat: Ts: got [-1.0]"),
        (PLANT | {"Ts": 0.0}, "plant.mat: sampling_time: got None; expected seconds per step. The plant is continuous"),
        (PLANT | {"E": 2 * np.eye(2)}, "plant.mat: E: got a descriptor matrix"),
        (PLANT | {"InputDelay": [[0.0, 2.0]]}, "plant.mat: InputDelay: got a delay"),
        (PLANT | {"InputDelay": "long"}, "plant.mat: InputDelay: got array(['long']"),
        (PLANT | {"A": "text"}, "plant.mat: A: got array(['text']"),
        (PLANT | {"A": [[np.nan]]}, "plant.mat: A[0][0]: got nan"),
        (PLANT | {"A": np.ones((1, 2))}, "plant.mat.A: got shape (1, 2)"),
    ],
)
def test_what_is_no_plant_is_named(tmp_path, variables, message):
    savemat(tmp_path / "plant.mat", variables)
    with pytest.raises(ProblemError, match=re.escape(message)):
        lfo.LinearDynamics.from_mat(tmp_path / "plant.mat")


def test_a_file_that_is_no_mat_file_is_named(tmp_path):
    with pytest.raises(ProblemError, match=r"got no such file"):
        lfo.LinearDynamics.from_mat(tmp_path / "none.mat")
    (tmp_path / "plant.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    with pytest.raises(ProblemError, match=r"got a \.mat file of version 7\.3; expected a \.mat file of ver"):
        lfo.LinearDynamics.from_mat(tmp_path / "plant.mat")
    (tmp_path / "plant.mat").write_bytes(b"no plant")
    with pytest.raises(ProblemError, match=r"expected a .mat file of version 5 or 7\. In MATLAB: s = struct"):
        lfo.LinearDynamics.from_mat(tmp_path / "plant.mat")


def test_a_problem_file_has_known_inputs_of_a_continuous_model(tmp_path):
    text = "schema = 2\nhorizon = 3\ncost.R = 1.0\n[dynamics]\nA = [[0.0]]\nB = [[1.0]]\nsampling_time = 0.5\n"
    inputs = "disturbance = [[2.0]]\nd = [[1.0], [0.0], [-1.0]]\n"
    (tmp_path / "a.toml").write_text(f"{text}continuous = true\n{inputs}")
    assert lfo.read_problem(tmp_path / "a.toml").dynamics.offset.tolist() == [[1.0], [0.0], [-1.0]]
    (tmp_path / "b.toml").write_text(f"{text}{inputs}")
    with pytest.raises(
        ProblemError, match=r"dynamics.disturbance: got values; expected none without continuous = true"
    ):
        lfo.read_problem(tmp_path / "b.toml")

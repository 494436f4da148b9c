"""Input shapers for bands of modes: vibration by a formula of its own, the theorem, the literature, bad input."""

import json

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.comparison import SHAPERS, Modes, bands_of, eigenvalues_of, known_shaper, shorten
from lin_freq_ocp.solving import solve_judged

COARSE = 1e-3  # seconds: a search of a tenth of a second

# Bands in Hz, damping ratios, and in ms: the least duration on a grid of 0.1 ms, of four impulses, and of none.
CASES = {
    "one band": ((35, 60), 0.1, 24.1, 24.019, 23.9),
    "undamped": ((35, 60), 0.0, 27.1, 27.044, 27.0),
    "two resonances": ([(33.25, 36.75), (57, 63)], 0.1, 21.8, 21.738, 21.7),
    "any damping": ((35, 60), (0.05, 0.2), 26.3, 26.290, 26.2),
}


def ringing(amplitudes, times, frequency, damping):
    """The amplitude of a mode after impulses that change its speed, relative to one impulse at the end."""
    w = 2 * np.pi * frequency
    damped = w * np.sqrt(1 - damping**2)
    q, v = 0.0, 0.0
    for k, A in enumerate(amplitudes):
        v += A
        h = times[k + 1] - times[k] if k + 1 < len(times) else 0.0
        c, s, decay = np.cos(damped * h), np.sin(damped * h), np.exp(-damping * w * h)
        q, v = (
            decay * (q * (c + damping * w / damped * s) + v / damped * s),
            decay * (v * (c - damping * w / damped * s) - q * w**2 / damped * s),
        )
    return np.hypot(q * damped, v + damping * w * q)


@pytest.fixture(scope="module")
def found():
    return lfo.shaper((35, 60), damping=(0.0, 0.1), step=COARSE)


@expensive
@pytest.mark.parametrize("name", CASES)
def test_the_shortest_shaper_and_its_bound_have_known_durations(name):
    bands, damping, grid, four, none = CASES[name]
    shaper = lfo.shaper(bands, damping)
    assert (shaper.on_grid.horizon - 1) * 0.1 == pytest.approx(grid)
    assert shaper.on_grid.proven
    assert 1e3 * shaper.duration == pytest.approx(four, rel=1e-3)
    assert 1e3 * shaper.shortest == pytest.approx(none, abs=1e-9)
    assert len(shaper.times) == 4
    assert shaper.largest <= 0.05
    known = {kind: one.duration for kind, (_, one) in shaper.known.items()}
    assert set(known) == {"2HUMP_EI", "3HUMP_EI"}
    assert min(known.values()) > shaper.duration


@expensive
def test_the_vibration_is_what_impulses_leave(found):
    for frequency, damping in np.random.default_rng(0).uniform((20, 0), (90, 0.3), (50, 2)):
        expected = ringing(found.amplitudes, found.times, frequency, damping)
        assert found.vibration(frequency, damping) == pytest.approx(expected, rel=1e-9)
    inside = [found.vibration(f, z) for f, z in np.random.default_rng(1).uniform((35, 0), (60, 0.1), (2000, 2))]
    assert 0.9 * found.largest < max(inside) <= found.largest <= found.limit
    assert found.amplitudes.sum() == pytest.approx(1)
    assert (found.amplitudes >= 0).all()
    assert found.times[0] == 0
    assert (np.diff(found.times) > 0).all()


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_no_shorter_impulses_at_any_times_keep_the_limit(found, seed):
    """Impulses from random ones on, as little vibration as local search reaches within the duration."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 7))
    times = np.sort(np.append(0.0, random.uniform(0, found.shortest, count - 1)))
    start = known_shaper("ZV", 45.0, 0.0)
    start = type(start)(random.dirichlet(np.ones(count)), times * found.shortest / times[-1])
    modes = found.modes.eigenvalues(found.shortest)
    best = shorten(start, modes, found.limit)
    assert best.duration > found.shortest or np.abs(best.response(modes)).max() > found.limit


@expensive
def test_too_few_impulses_are_refused():
    with pytest.raises(
        lfo.errors.ProblemError, match=r"shaper.impulses: got 2, and no shaper of so few.*larger vibration. . do"
    ):
        lfo.shaper((35, 60), impulses=2, step=2e-3)


@expensive
def test_a_cluster_that_one_impulse_cannot_replace_is_split():
    shaper = lfo.shaper((0.8, 1.2), damping=0.0, step=0.02)
    assert len(shaper.times) > 3  # three impulses leave 5.01 % at any times
    assert shaper.largest <= 0.05
    assert shaper.shortest <= shaper.duration <= 1.01


@expensive
def test_a_longer_search_follows_where_the_first_durations_are_too_short(monkeypatch):
    substitute(monkeypatch, "api.FIRST_PERIODS", 0.5)
    shaper = lfo.shaper((35, 60), step=2e-3)
    assert shaper.duration > 0.5 / 35
    assert shaper.on_grid.horizons[0] > 2
    assert shaper.on_grid.proven


@expensive
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_the_unit_of_time_changes_nothing(found, factor):
    other = lfo.shaper((35 * factor, 60 * factor), (0.0, 0.1), step=COARSE / factor)
    assert other.duration * factor == pytest.approx(found.duration, rel=1e-6)
    assert other.shortest * factor == pytest.approx(found.shortest, rel=1e-9)


# --- shapers of the literature ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("name", SHAPERS)
def test_a_shaper_of_the_literature_leaves_what_its_source_says(name, damping):
    shaper = known_shaper(name, 40.0, damping)
    left = ringing(shaper.amplitudes, shaper.times, 40.0, damping)
    period = 1 / (40.0 * np.sqrt(1 - damping**2))
    assert shaper.duration / period == pytest.approx(
        {"ZV": 0.5, "MZV": 0.75, "2HUMP_EI": 1.5, "3HUMP_EI": 2.0}.get(name, 1.0)
    )
    assert shaper.amplitudes.sum() == pytest.approx(1)
    if damping == 0:
        expected = {"ZV": 0.0, "MZV": 0.0, "ZVD": 0.0, "EI": 0.05, "2HUMP_EI": 0.0, "3HUMP_EI": 0.05}
        assert left == pytest.approx(expected[name], abs=1e-3)
    near = eigenvalues_of(np.linspace(40 * 0.97, 40 * 1.03, 61), np.full(61, damping))
    widest = np.abs(shaper.response(near)).max()
    assert widest < (0.05 if name in ("ZV", "MZV", "ZVD") else 0.054)


def test_humps_reach_their_share_between_their_zeros():
    frequencies = np.linspace(20.0, 60.0, 4001)
    for name, humps in (("2HUMP_EI", 2), ("3HUMP_EI", 3)):
        left = np.abs(known_shaper(name, 40.0, 0.0).response(eigenvalues_of(frequencies, np.zeros(4001))))
        peaks = left[1:-1][(left[1:-1] > left[:-2]) & (left[1:-1] > left[2:])]
        low = peaks[peaks < 0.06]
        assert len(low) == humps
        np.testing.assert_allclose(low, 0.05, atol=1.5e-3)


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"bands": (60, 35)}, r"shaper.bands: got \(60, 35\); expected \(lowest, highest\) in Hz"),
        ({"bands": (0, 35)}, "shaper.bands: got"),
        ({"bands": []}, "shaper.bands: got"),
        ({"bands": [(1, 2, 3)]}, "shaper.bands: got"),
        ({"bands": "35-60"}, "shaper.bands: got '35-60'; expected numbers"),
        ({"damping": 1.0}, "shaper.damping: got 1.0; expected a damping ratio from 0 to below 1"),
        ({"damping": (0.2, 0.1)}, "shaper.damping: got"),
        ({"vibration": 1.0}, "shaper.vibration: got 1.0; expected a number below 1. A single impulse has 1"),
        ({"vibration": 0.0}, "shaper.vibration: got"),
        ({"impulses": 1}, "shaper.impulses: got 1; expected 2 or more"),
        ({"impulses": 2.5}, "shaper.impulses: got 2.5"),
        ({"step": 0.1}, "shaper.step: got 0.1; expected at most 0.0026526 s"),
    ],
)
def test_bad_input_is_refused(fields, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.shaper(**({"bands": (35, 60)} | fields))


# --- calibrations ----------------------------------------------------------------------------------------------------

HZ = np.arange(5.0, 120.0, 0.5)


def resonance(at, width=2.0):
    return 1 / (1 + ((HZ - at) / width) ** 2)


def table(power, head="freq,psd_x,psd_y,psd_z,psd_xyz,shapers:,zv(40.0)"):
    return "\n".join([head, *(f"{f:.1f},0,0,0,{p:.6f},,0.1" for f, p in zip(HZ, power, strict=True))])


@pytest.mark.parametrize(
    ("power", "share", "bands"),
    [
        (resonance(41), 0.05, ((30.9, 52.0),)),
        (resonance(41) + 0.4 * resonance(80), 0.05, ((30.9, 52.0), (70.8, 89.2))),
        (resonance(41) + 0.15 * resonance(57), 0.05, ((30.9, 63.0),)),  # they meet
        (resonance(41) + 0.4 * resonance(57), 0.2, ((35.1, 47.2), (52.2, 62.0))),
    ],
    ids=["one peak", "two", "joined", "two above a larger share"],
)
def test_bands_are_where_the_power_is(tmp_path, power, share, bands):
    for encoding in ("utf-8", "utf-16"):
        (tmp_path / "calibration.csv").write_text(table(power), encoding=encoding)
        assert lfo.io.read_calibration(tmp_path / "calibration.csv", share) == bands
    (tmp_path / "calibration.csv").write_text(f"#{table(power)}")  # the header as a comment
    assert lfo.io.read_calibration(tmp_path / "calibration.csv", share) == bands
    assert bands_of(HZ, power, share) == bands


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "header: got an empty file; expected the names of the columns"),
        ("#time,accel_x,accel_y,accel_z\n0,1,2,3\n", "got accelerations over time; expected the power over frequency"),
        ("freq,psd_x\n1,2\n2,3\n", "column 'psd_xyz': got none .*; expected .*. Did you mean 'psd_x'"),
        ("freq,psd_xyz\n1,2\n2,x\n", "line 3, column 'psd_xyz': got 'x'; expected a finite number"),
        ("freq,psd_xyz\n2,2\n1,3\n", "freq: got .*; expected ascending frequencies in Hz"),
        ("freq,psd_xyz\n1,0\n2,0\n", "psd_xyz: got zeros alone; expected a power"),
        ("freq,psd_xyz\n1,-1\n2,0\n", "psd_xyz: got negative values; expected a power"),
        ("freq,psd_xyz\n1,1\n", "expected ascending frequencies"),
    ],
)
def test_other_files_are_refused(tmp_path, text, words):
    (tmp_path / "calibration.csv").write_text(text)
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.io.read_calibration(tmp_path / "calibration.csv")


# --- the command -----------------------------------------------------------------------------------------------------


@expensive
def test_the_command_prints_what_firmware_takes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(
        "shaper", "--band", "0.85", "1.15", "--damping", "0", "0", "--vibration", "0.3", "--plot", "a.png"
    )
    assert status == 0
    lines = dict(line.split(maxsplit=1) for line in out.splitlines())
    A, T = (np.array(json.loads(lines[name].removesuffix(" s"))) for name in "AT")
    assert A.sum() == pytest.approx(1, abs=1e-5)
    found = json.loads(
        run("shaper", "--band", "0.85", "1.15", "--damping", "0", "0", "--vibration", "0.3", "--json")[1]
    )
    np.testing.assert_allclose(A, found["A"], atol=1e-6)
    np.testing.assert_allclose(T, found["T"], atol=1e-9)
    assert found["shortest"] <= found["duration"] == found["T"][-1]
    assert found["known"]["ZV"]["duration"] == pytest.approx(0.5, rel=0.2)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@expensive
def test_a_calibration_gives_two_choices_of_bands(tmp_path):
    path = tmp_path / "calibration.csv"
    path.write_text(table(resonance(41) + 0.15 * resonance(57)))
    status, out, _ = run("shaper", "--csv", str(path), "--damping", "0", "0", "--vibration", "0.3")
    assert status == 0
    assert "every mode of 30.9 to 63 Hz" in out
    assert "Power above 20 % of its largest: 35.1 to 47.2 Hz" in out


@pytest.mark.parametrize("limit", [0.0, 0.3])
def test_ctrl_c_keeps_the_shaper_that_is_found(monkeypatch, limit):
    """The shaper is looked for with a limit of 0.3, its proof with a wider one."""

    def interrupted(problem, *options, **more):
        if problem.control_spectrum[0].limit > limit:
            raise KeyboardInterrupt
        return solve_judged(problem, *options, **more)

    substitute(monkeypatch, "solving.solve_judged", interrupted)
    status, out, err = run("shaper", "--band", "0.85", "1.15", "--damping", "0", "0", "--vibration", "0.3")
    assert (status, err) == (130, "")
    assert ("A         [0" in out) == (limit > 0)
    assert ("nothing is proven of shorter ones (interrupted)" in out) == (limit > 0)


def test_the_command_asks_for_bands(tmp_path):
    assert run("shaper")[0] == 2
    assert "--band: got none" in run("shaper")[2]
    assert run("shaper", "--band", "1", "2", "--csv", str(tmp_path / "a.csv"))[0] == 2


def test_modes_are_named():
    assert str(Modes(((35.0, 60.0), (80.0, 80.0)), (0.0, 0.1))) == (
        "every mode of 35 to 60 and 80 Hz with a damping ratio of 0 to 0.1"
    )

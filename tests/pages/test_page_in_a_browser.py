"""Report pages in a real browser: silent, offline, described, printed in ink on paper, enlarged, and narrow."""

import pytest

import lin_freq_ocp as lfo
from helpers.browsers import DARK, complaints, emulate, requested, screen
from helpers.seeds import seeds

PAPER = 720  # px: what is left of A4 between its margins


def move(steps=20, sampling_time=0.1, **fields):
    """Return a move of a mass within two seconds."""
    h = sampling_time
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2], [h]], sampling_time=h)
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=[0.5, 0.0])
    return lfo.OptimalControlProblem(
        dynamics, steps, cost, control_set=fields.pop("control_set", lfo.Box(-1, 1)), **fields
    )


def slow(cutoff):
    return {"control_spectrum": lfo.low_pass(cutoff_hz=cutoff)}


FROM_REST = {"initial_state": [0.0, 0.0], "terminal_state": [0.5, 0.0]}
SAVED = {
    "linear": lambda: lfo.compare(move(**FROM_REST, **slow(1.5)), ["brickwall"]),
    "infeasible": lambda: lfo.compare(move(**FROM_REST, **slow(0.3)), []),
    "levels": lambda: lfo.compare(
        move(8, 0.25, **FROM_REST, **slow(1.5), control_set=lfo.FiniteSet([-1, 0, 1])), ["brickwall"]
    ),
    "periodic": lambda: lfo.compare(move(terminal_state=lfo.Periodic(), **slow(1.5)), ["brickwall"]),
    "response": lambda: lfo.compare(lfo.library.wave_energy(horizon=40), ["brickwall"]),
    "vibration": lambda: lfo.compare(lfo.library.printer_move(14, distance=2e-3, vibration_bound=2.0)),
    "loop": lambda: lfo.RecedingHorizon(move(terminal_state=[0.0, 0.0])).run([0.2, 0.0], 3),
}


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Return the address of a page, which is written when it is first asked for."""
    folder, written = tmp_path_factory.mktemp("pages"), {}

    def of(name):
        if name not in written:
            written[name] = SAVED[name]().save(folder / name).as_uri()
        return written[name]

    return of


def asked(browser, expression):
    return browser.execute_script(f"return {expression}")


@pytest.mark.parametrize("name", seeds(SAVED))
def test_a_page_is_silent_offline_described_narrow_and_printed_on_white(browser, address, name):
    browser.get_log("performance")
    url = address(name)
    browser.get(url)
    assert complaints(browser) == []
    assert {one for one in requested(browser) if not one.startswith("data:")} == {url}
    texts = asked(browser, "[...document.querySelectorAll('svg')].map((one) => one.getAttribute('aria-label'))")
    assert len(set(texts)) == len(texts) > 0
    assert all(texts)
    assert asked(browser, "[...document.querySelectorAll('svg')].every((one) => one.getAttribute('role') === 'img')")
    assert asked(browser, "[...document.querySelectorAll('img')].length") == 0
    screen(browser, 320)
    assert asked(browser, "document.documentElement.scrollWidth") <= 320
    screen(browser, PAPER)
    emulate(browser, "print", DARK)
    assert asked(browser, "getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert asked(browser, "[...document.querySelectorAll('.zoom')].every((one) => !one.checkVisibility())")
    assert asked(browser, "Math.max(...[...document.querySelectorAll('svg')].map((one) => one.clientWidth))") <= PAPER
    emulate(browser, "", DARK)
    assert asked(browser, "getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 29)"


def test_a_figure_is_enlarged_by_the_keyboard_and_back(browser, address):
    from selenium.webdriver import Keys

    width = "document.querySelector('figure svg').getBoundingClientRect().width"
    browser.get(address("linear"))
    before, box = asked(browser, width), browser.find_element("css selector", ".zoom input")
    box.send_keys(Keys.SPACE)
    assert asked(browser, width) == pytest.approx(2.5 * before, rel=0.02)
    assert asked(browser, "document.documentElement.scrollWidth") <= 1280
    emulate(browser, "print")
    assert asked(browser, width) <= 1280
    emulate(browser)
    box.send_keys(Keys.SPACE)
    assert asked(browser, width) == before

"""The live page and the static page in a real browser: sliders, keys, cures, colours, widths, and what is requested."""

import threading
import time
from contextlib import contextmanager
from functools import partial

import pytest

import lin_freq_ocp as lfo
from helpers.browsers import DARK, complaints, emulate, requested, screen
from helpers.patience import PATIENCE
from helpers.seeds import expensive
from lin_freq_ocp.pages import ExploreServer, Session, static_page


def new_session():
    return Session(lfo.library.double_integrator(), lambda horizon: lfo.library.double_integrator(horizon=horizon))


@contextmanager
def served(session):
    """Yield the address of a live page."""
    with ExploreServer(session) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def address():
    with served(new_session()) as url:
        yield url


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(static_page(new_session()), encoding="utf-8")
    return path.as_uri()


def until(browser, condition):
    """Wait until an expression of JavaScript is true."""
    end = time.monotonic() + PATIENCE
    while not browser.execute_script(f"return Boolean({condition})"):
        assert time.monotonic() < end, f"waited for {condition}: {browser.find_element('id', 'badge').text}"
        time.sleep(0.02)


def opened(browser, url):
    """Open a page, and wait for its first answer and what stands beside it."""
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get(url)
    until(browser, "document.getElementById('cost-filtered').textContent")
    return shown(browser)


def shown(browser):
    return {what: part(browser, what).text for what in ("cost", "status", "gap")}


def part(browser, name):
    return browser.find_element("css selector", f"[data-testid='{name}']")


def settled(browser, move):
    """Make a move, and wait for its answer."""
    before = browser.execute_script("return order")
    move()
    until(browser, f"order > {before} && document.getElementById('controls').dataset.order === String(order)")
    return shown(browser)


def dragged(browser, name, pixels):
    from selenium.webdriver import ActionChains

    slider = part(browser, name)
    low, high, value = (float(slider.get_attribute(what)) for what in ("min", "max", "value"))
    thumb = round(((value - low) / (high - low) - 0.5) * (slider.size["width"] - 16))
    chain = ActionChains(browser).move_to_element_with_offset(slider, thumb, 0).click_and_hold()
    chain.move_by_offset(pixels, 0).release().perform()


def drawn(browser, kind):
    paths = f"[...document.querySelectorAll('path.{kind}')]"
    return browser.execute_script(f"return {paths}.map((one) => one.getAttribute('d'))")


@expensive
def test_a_dragged_slider_changes_cost_and_drawing(browser, address):
    first, path = opened(browser, address), drawn(browser, "constrained")
    assert first["status"] == "optimal, proven"
    assert first["cost"] == "6.38576"
    assert float(first["gap"]) < 1e-6
    second = settled(browser, lambda: dragged(browser, "cutoff", -20))
    assert float(second["cost"]) > float(first["cost"])
    assert drawn(browser, "constrained") != path
    assert part(browser, "cutoff").get_attribute("aria-valuetext").endswith("Hz")


@expensive
def test_an_infeasible_setting_shows_conflict_and_cures_that_cure(browser, address):
    opened(browser, address)
    found = settled(browser, lambda: dragged(browser, "cutoff", -60))
    assert found["status"] == "infeasible, proven"
    assert found["cost"] == "\N{EN DASH}"
    assert "stop band" in part(browser, "conflict").text
    until(browser, "document.getElementById('cures').textContent.includes('cut-off')")
    button = next(one for one in part(browser, "cures").find_elements("tag name", "button") if "cut-off" in one.text)
    assert settled(browser, button.click)["status"] == "optimal, proven"
    assert not part(browser, "conflict").is_displayed()


def test_arrow_keys_move_sliders_and_boxes_hide_trajectories(browser, address):
    from selenium.webdriver import Keys

    first = opened(browser, address)
    slider = part(browser, "cutoff")
    browser.execute_script("arguments[0].focus()", slider)
    second = settled(browser, lambda: slider.send_keys(Keys.ARROW_LEFT * 5))
    assert float(second["cost"]) > float(first["cost"])
    assert len(drawn(browser, "classical")) == len(drawn(browser, "constrained")) > 0
    browser.find_element("id", "show-classical").send_keys(Keys.SPACE)
    assert drawn(browser, "classical") == []
    words = browser.execute_script("return document.querySelector('figure svg').getAttribute('aria-label')")
    assert "classical" not in words
    assert "constrained" in words


def test_the_newest_position_wins(browser, address):
    opened(browser, address)
    slider = part(browser, "cutoff")
    moves = "for (let n = -20; n <= 0; n++) { arguments[0].value = n; arguments[0].dispatchEvent(new Event('input')); }"
    last = settled(browser, lambda: browser.execute_script(moves, slider))
    assert last["cost"] == "6.38576"


@expensive
@pytest.mark.parametrize("page", ["address", "file"])
def test_nothing_is_requested_elsewhere_and_nothing_complains(browser, page, request):
    url = request.getfixturevalue(page)
    opened(browser, url)
    settled(browser, lambda: dragged(browser, "cutoff", -20))
    settled(browser, lambda: dragged(browser, "cutoff", 30))
    time.sleep(0.3)
    assert complaints(browser) == []
    urls = {one for one in requested(browser) if not one.startswith("data:")}
    assert urls
    assert all(one.startswith(url) for one in urls)


def test_a_slow_solve_is_shown(browser, monkeypatch):
    from selenium.webdriver import Keys

    session = new_session()
    with served(session) as url:
        opened(browser, url)
        release, answer = threading.Event(), session.answer
        monkeypatch.setattr(session, "answer", lambda values: release.wait(PATIENCE) and answer(values))
        part(browser, "cutoff").send_keys(Keys.ARROW_LEFT)
        until(browser, "document.getElementById('badge').textContent === 'solving, 1 s'")
        assert browser.find_element("id", "results").get_attribute("aria-busy") == "true"
        assert browser.find_element("id", "panels").value_of_css_property("opacity") == "0.55"
        release.set()
        until(browser, "document.getElementById('results').getAttribute('aria-busy') === 'false'")
        until(browser, "document.getElementById('badge').dataset.status")
        assert shown(browser)["status"] == "optimal, proven"


def test_the_static_page_shows_the_nearest_solved_point(browser, file):
    first = opened(browser, file)
    assert first["cost"] == "6.38576"
    assert settled(browser, lambda: dragged(browser, "bound.0", -60))["cost"] != first["cost"]
    assert settled(browser, lambda: dragged(browser, "cutoff", -60))["status"] == "infeasible, proven"
    button = part(browser, "cures").find_elements("tag name", "button")[-1]
    assert settled(browser, button.click)["status"] == "optimal, proven"


@pytest.mark.parametrize("page", ["address", "file"])
def test_a_narrow_dark_screen_shows_all_without_scrolling_sideways(browser, page, request):
    screen(browser, 320, 700)
    opened(browser, request.getfixturevalue(page))
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 320
    light = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    emulate(browser, features=DARK)
    dark = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert light == "rgb(255, 255, 255)"
    assert dark == "rgb(20, 24, 29)"


@pytest.mark.parametrize("page", ["address", "file"])
def test_on_a_phone_a_slider_and_a_plot_are_seen_at_once(browser, page, request):
    screen(browser, 400, 800)
    opened(browser, request.getfixturevalue(page))
    for figure in range(len(browser.find_elements("css selector", ".panels figure"))):
        browser.execute_script(f"document.querySelectorAll('.panels figure')[{figure}].scrollIntoView()")
        edges = "[...document.querySelectorAll('.panels figure')].map(one => one.getBoundingClientRect())"
        plot = browser.execute_script(f"return {edges}[{figure}].toJSON()")
        controls = browser.execute_script("return document.getElementById('controls').getBoundingClientRect().toJSON()")
        slider = browser.find_element("css selector", "input[type='range']").rect
        assert plot["bottom"] <= controls["top"]
        assert controls["top"] < slider["y"] - browser.execute_script("return scrollY") < 800


def limited_move():
    """Return a move with a notch, a mask, a rate limit and a bound on the speed."""
    dynamics = lfo.LinearDynamics(
        [[1.0, 0.1], [0.0, 1.0]],
        [[0.005], [0.1]],
        state_names=["position [m]", "speed [m/s]"],
        control_names=["force [N]"],
        sampling_time=0.1,
    )
    spectrum = [
        lfo.spectrum.notch(centre_hz=1.5, width_hz=0.6),
        lfo.MagnitudeBound(0.3, band=lfo.low_pass(cutoff_hz=1.0)),
    ]
    problem = lfo.OptimalControlProblem(
        dynamics,
        40,
        lfo.QuadraticCost(R=0.1),
        control_set=lfo.Box(-2, 2),
        state_set=lfo.Box([None, -0.4], [None, 0.4]),
        initial_state=[1, 0],
        terminal_state=[0, 0],
        control_spectrum=spectrum,
    )
    return lfo.rate_limited(problem, 0.5, previous=0)


@expensive
def test_masks_notches_rates_and_bounds_of_states_can_be_moved(browser):
    with served(Session(limited_move())) as url:
        first = opened(browser, url)
        assert first["status"] == "optimal, proven"
        assert "no single low pass" in part(browser, "cutoff").text
        browser.find_element("css selector", "#states summary").click()
        for key, notches in {
            "level.control_spectrum.1": -8,
            "edge.control_spectrum.0.0": -2,
            "edge.control_spectrum.0.1": 4,
            "rows.0": -20,
            "state_bound.1": -3,
        }.items():
            slider = part(browser, key)
            assert slider.is_displayed()
            browser.execute_script("arguments[0].focus()", slider)
            there = settled(browser, partial(slider.send_keys, keys(notches)))
            assert there["status"] == "optimal, proven"
            assert float(there["cost"]) > float(first["cost"]) * (1 + 1e-4), key
            assert settled(browser, browser.find_element("id", "reset").click) == first
        assert part(browser, "level.control_spectrum.1").get_attribute("aria-valuetext") == "0 dB"
        assert complaints(browser) == []


@expensive
def test_an_infeasible_bound_of_a_state_is_cured_by_a_button(browser):
    with served(Session(limited_move())) as url:
        opened(browser, url)
        browser.find_element("css selector", "#states summary").click()
        slider = part(browser, "state_bound.1")
        assert settled(browser, lambda: slider.send_keys(keys(-15)))["status"] == "infeasible, proven"
        assert "speed" in part(browser, "conflict").text
        until(browser, "document.getElementById('cures').textContent.includes('speed')")
        button = next(
            one for one in part(browser, "cures").find_elements("tag name", "button") if "|speed|" in one.text
        )
        assert settled(browser, button.click)["status"] == "optimal, proven"


def keys(notches):
    from selenium.webdriver import Keys

    return (Keys.ARROW_LEFT if notches < 0 else Keys.ARROW_RIGHT) * abs(notches)

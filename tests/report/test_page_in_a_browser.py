"""Pages of comparisons in a real browser: the console is silent, nothing is loaded, figures can be enlarged."""

import pytest

import lin_freq_ocp as lfo
from helpers.browsers import chromium, complaints, requested


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    problems = {"linear": lfo.library.double_integrator(), "modes": lfo.library.pendulum_with_wall(horizon=4)}
    return {name: lfo.compare(problem).save(folder / name).as_uri() for name, problem in problems.items()}


@pytest.mark.parametrize("name", ["linear", "modes"])
def test_the_console_is_silent_and_nothing_is_loaded(pages, name):
    with chromium() as browser:
        browser.get(pages[name])
        assert complaints(browser) == []
        assert {one for one in requested(browser) if not one.startswith("data:")} == {pages[name]}
        unnamed = "return [...document.querySelectorAll('svg')].filter((one) => !one.getAttribute('aria-label')).length"
        assert browser.execute_script(unnamed) == 0


def test_a_figure_is_enlarged_by_the_keyboard_and_back(pages):
    from selenium.webdriver import Keys

    width = "return document.querySelector('figure svg').getBoundingClientRect().width"
    with chromium() as browser:
        browser.get(pages["linear"])
        before, box = browser.execute_script(width), browser.find_element("css selector", ".zoom input")
        box.send_keys(Keys.SPACE)
        assert browser.execute_script(width) == pytest.approx(2.5 * before, rel=0.02)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 1280
        box.send_keys(Keys.SPACE)
        assert browser.execute_script(width) == before


def test_a_narrow_screen_does_not_scroll_sideways(pages):
    with chromium(320, 700) as browser:
        browser.get(pages["linear"])
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 320

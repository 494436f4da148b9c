"""The suite of pages: one file each that names all signals; in a browser silent, offline, described, and narrow.

tests/pages/test_browser.py moves the sliders of the explorer.
"""

import re
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.browsers import DARK, complaints, emulate, requested, screen
from helpers.instances.pages import NAMES, PAGES
from helpers.pages import parsed
from helpers.seeds import expensive, seeds

NAMESPACE = "http://www.w3.org/2000/svg"  # in a script; nothing is loaded from there
PAPER = 720  # px: what is left of A4 between its margins


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Return the file of a page, which is written when it is first asked for."""
    folder, written = tmp_path_factory.mktemp("pages"), {}

    def of(name):
        if name not in written:
            written[name] = PAGES[name][1](folder / name)
        return written[name]

    return of


def test_every_page_of_the_package_is_here():
    templates = Path(lfo.__file__).parent.rglob("*.html.jinja")
    assert {one.name.removesuffix(".html.jinja") for one in templates} == {template for template, _ in PAGES.values()}


@expensive
@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_one_file_that_loads_nothing_and_names_all_signals(saved, name):
    html = saved(name).read_text(encoding="utf-8").replace(NAMESPACE, "")
    found = parsed(html)
    assert not found.open
    assert "://" not in html
    assert not {"iframe", "object", "base"} & set(found.tags)
    assert ("script" in found.tags) == (name == "explorer")
    assert len(set(found.identifiers)) == len(found.identifiers)
    assert "@import" not in found.styles
    targets = [one.removeprefix("#") for one in found.references if one.startswith("#")]
    assert all(one.startswith(("#", "data:")) for one in found.references)
    targets += re.findall(r"url\(#([^)]*)\)", found.styles)
    assert len(re.findall(r"url\(", found.styles)) == len(re.findall(r"url\(#", found.styles))
    assert set(targets) <= set(found.identifiers)
    assert len(html.encode()) < 1.5e6
    assert "<b>move" not in html
    assert "<p> [m]" not in html
    if name not in ("response", "vibration"):  # problems of the library
        assert "<b>move</b> & $stay$" in found.text
        for words in () if name == "sweep" else (*NAMES[0], *NAMES[1]):  # a sweep has one row a problem and no signal
            assert words in found.text


def asked(browser, expression):
    return browser.execute_script(f"return {expression}")


@pytest.mark.parametrize("name", seeds([name for name in PAGES if name != "explorer"]))
def test_a_page_is_silent_offline_described_narrow_and_printed_on_white(browser, saved, name):
    browser.get_log("performance")
    url = saved(name).as_uri()
    browser.get(url)
    assert complaints(browser) == []
    assert {one for one in requested(browser) if not one.startswith("data:")} == {url}
    texts = asked(browser, "[...document.querySelectorAll('svg')].map((one) => one.getAttribute('aria-label'))")
    assert len(set(texts)) == len(texts)
    assert bool(texts) == (name != "problem")  # a problem is told by tables alone
    assert all(texts)
    assert asked(browser, "[...document.querySelectorAll('svg')].every((one) => one.getAttribute('role') === 'img')")
    assert asked(browser, "[...document.querySelectorAll('img')].length") == 0
    screen(browser, 320)
    assert asked(browser, "document.documentElement.scrollWidth") <= 320
    screen(browser, PAPER)
    emulate(browser, "print", DARK)
    assert asked(browser, "getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert asked(browser, "[...document.querySelectorAll('.zoom')].every((one) => !one.checkVisibility())")
    widths = asked(browser, "[...document.querySelectorAll('svg')].map((one) => one.clientWidth)")
    assert max(widths, default=0) <= PAPER
    emulate(browser, "", DARK)
    assert asked(browser, "getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 29)"


@expensive
def test_a_figure_is_enlarged_by_the_keyboard_and_back(browser, saved):
    from selenium.webdriver import Keys

    width = "document.querySelector('figure svg').getBoundingClientRect().width"
    browser.get(saved("linear").as_uri())
    before, box = asked(browser, width), browser.find_element("css selector", ".zoom input")
    box.send_keys(Keys.SPACE)
    assert asked(browser, width) == pytest.approx(2.5 * before, rel=0.02)
    assert asked(browser, "document.documentElement.scrollWidth") <= 1280
    emulate(browser, "print")
    assert asked(browser, width) <= 1280
    emulate(browser)
    box.send_keys(Keys.SPACE)
    assert asked(browser, width) == before

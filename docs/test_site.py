"""The built site in a browser with the width of a phone.

Run by .ci/run after docs/build.sh: python -m pytest docs/test_site.py
"""

import re
from pathlib import Path

import pytest

from helpers.browsers import browser as browser
from helpers.browsers import chromium as chromium
from helpers.browsers import screen

DOCS = Path(__file__).parent
FILES = [path for folder in (".", "how_to", "tutorials") for path in sorted((DOCS / folder).glob("*.md"))]
PAGES = [str(path.relative_to(DOCS).with_suffix("")) for path in FILES]
CLASSES = ("MagnitudeBound", "QuadraticCost", "ResidualVibration", "costs.L1Cost", "library.mri_gradient")
REFERENCE = [f"api/names/lin_freq_ocp.{name}" for name in CLASSES]  # pages with long formulas
NOT_SET = """
const faults = ".math:not(:has(mjx-container)), mjx-merror, mtext[mathcolor=red]"  // the last: unknown commands
return [...document.querySelectorAll(faults)].map(formula => formula.textContent)
"""
WIDTHS = "const page = document.querySelector('.content'); return [page.scrollWidth, page.clientWidth]"


@pytest.mark.parametrize("page", [*PAGES, *REFERENCE, "genindex"])
def test_a_page_fits_a_phone_and_its_formulas_are_set(browser, page):
    screen(browser, 400)
    browser.get((DOCS / "_build" / "html" / f"{page}.html").as_uri())
    browser.execute_async_script("Promise.resolve(window.MathJax?.startup?.promise).then(arguments[0])")
    assert browser.execute_script(NOT_SET) == []
    wanted, available = browser.execute_script(WIDTHS)
    assert wanted == available <= 400


def test_the_first_of_each_symbol_on_a_page_leads_to_the_glossary(browser):
    site = DOCS / "_build" / "html"
    anchors = set(re.findall(r'id="(symbol-.*?)"', (site / "glossary.html").read_text(encoding="utf-8")))
    assert {"symbol-eta-C", "symbol-rho-u", "symbol-J-optimal"} <= anchors
    for page in [*PAGES, *REFERENCE]:
        text = (site / f"{page}.html").read_text(encoding="utf-8")
        found = re.findall(r"\\href\{(.*?)glossary\.html#(.*?)\}", text)
        names = [name for _, name in found]
        assert set(names) <= anchors
        assert len(set(names)) == len(names)
        assert all(((site / page).parent / folder / "glossary.html").exists() for folder, _ in found)
    browser.get((site / "theory.html").as_uri())
    browser.execute_async_script("Promise.resolve(window.MathJax?.startup?.promise).then(arguments[0])")
    browser.execute_script("document.querySelector('mjx-container a').click()")
    assert browser.current_url.endswith("glossary.html#symbol-eta-C")


def test_the_page_of_a_class_shows_what_users_call():
    page = (DOCS / "_build" / "html" / "api" / "names" / "lin_freq_ocp.QuadraticCost.html").read_text(encoding="utf-8")
    names = re.findall(r'<dt class="sig sig-object py" id="lin_freq_ocp\.(.*?)"', page)
    assert names == ["QuadraticCost", *(f"QuadraticCost.{name}" for name in ("gradient", "stage_values", "value"))]

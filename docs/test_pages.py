"""The code of the pages runs as printed: the Python and the commands of README.md and docs/how_to.

Run by .ci/run: python -m pytest docs/test_pages.py
"""

import ast
import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ascii_formulas import as_formulas

ROOT = Path(__file__).parents[1]
GUIDES = sorted((ROOT / "docs" / "how_to").glob("*.md"))
PAGES = [ROOT / "README.md", *(path for path in GUIDES if path.stem != "index")]
CODE = re.compile(r"^(```|:::).*?^\1 *$|`[^`]+`|\]\([^)]*\)", re.DOTALL | re.MULTILINE)
FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$]+)\$", re.DOTALL)
AS_TEXT = re.compile(r"\b(?:eta|mu|nu|rho|lambda|theta|xi|alpha|phi|psi)(?:_|\b)|[<>]=|\b[A-Za-z]_[\w{]|\w\^")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_shows_runs(page, tmp_path):
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```(python|console)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    included = re.findall(r"^```{literalinclude} (\S+\.py)$", text, re.MULTILINE)
    assert included or "python" in [kind for kind, _ in blocks]
    for kind, text in blocks:
        if kind == "python":
            (tmp_path / "page.py").write_text(text)
        arguments = ["page.py"] if kind == "python" else ["-m", "lin_freq_ocp", *shlex.split(text)[2:]]
        subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True, capture_output=True)
    for name in included:  # it needs PyTorch; scripts/verify.py --part layers runs it, too
        pytest.importorskip("torch")
        subprocess.run([sys.executable, page.parent / name], cwd=tmp_path, check=True, capture_output=True)


def test_every_example_has_the_sketch_of_one_plant():
    assigned = {
        node.targets[0].id: node.value
        for node in ast.parse((ROOT / "docs" / "conf.py").read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    found = (name for value in assigned["SKETCHES"].values for name in ast.walk(value))
    shown = [name.value for name in found if isinstance(name, ast.Constant)]
    assert sorted(shown) == sorted(path.stem for path in (ROOT / "examples").glob("*/*.py"))


@pytest.mark.parametrize(
    "sketch", sorted((ROOT / "lin_freq_ocp" / "library" / "sketches").iterdir()), ids=lambda path: path.stem
)
def test_a_sketch_has_a_description_and_the_colours_of_the_page(sketch):
    root = ElementTree.fromstring(sketch.read_text(encoding="utf-8"))
    assert root.get("role") == "img"
    assert len(root.get("aria-label").split()) > 3
    colours = {element.get(kind, "none") for element in root.iter() for kind in ("stroke", "fill")}
    assert colours == {"none", "currentColor"}


@pytest.mark.parametrize("page", ["source.md", "architecture.md"])
def test_files_named_by_a_page_exist(page):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8").split("## A new cost")[0]
    named = [name for name in re.findall(r"`([a-z_/]+\.py)`", text) if "/" in name]
    assert len(named) > 10
    assert [name for name in named if not (ROOT / "lin_freq_ocp" / name).exists() and not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", [*sorted((ROOT / "docs").glob("*.md")), *GUIDES], ids=lambda page: page.stem)
def test_mathematics_is_written_as_formulas(page):
    text = CODE.sub("", page.read_text(encoding="utf-8"))
    assert AS_TEXT.findall(FORMULA.sub("", text)) == []
    for formula in (displayed or inline for displayed, inline in FORMULA.findall(text)):
        assert formula.count("{") == formula.count("}"), formula
        assert formula.count(r"\begin") == formula.count(r"\end"), formula
        assert "\n\n" not in formula, formula


FORMULAS = {  # as docstrings have them: what the site shows, in which « » enclose formulas
    "x_{t+1} = A_t x_t + B_t u_t + d_t": r"«x_{t+1} = A_{t}\,x_{t} + B_{t}\,u_{t}» «{}+ d_{t}»",
    "if |uhat_k| <= N/2 * a, then": r"if «|\hat{u}_{k}| \le N / 2 \cdot a», then",
    "a state x_t (n,) at t = 0 .. T-1": r"a state «x_{t}» (n,) at «t = 0 ,\dots, T - 1»",
    "sum_{t<T} 1/2 a'Q a + b_t": r"«\sum_{t<T} 1 / 2\,a'Q\,a + b_{t}»",
    "sqrt(g/L) and exp(-iwt)": r"«\sqrt{g / L}» and «\exp(-i\,w\,t)»",
    "{v : |v - centre| <= radius}": r"«\{v : |v - \text{centre}| \le \text{radius}\}»",
    "the angle theta in m/s^2, or kg m^2": "the angle «\\theta» in m/s\N{SUPERSCRIPT TWO}, or kg m\N{SUPERSCRIPT TWO}",
    "B and d in a step, a control 2 x 3": "B and d in a step, a control 2 x 3",
    "bins k <= T//2, as y+ = |y| has it": r"bins «k \le \lfloor T / 2 \rfloor», as «y^+ = |y|» has it",
    "impulses T_i that sum to one, with y = -u": "impulses «T_{i}» that sum to one, with y = -u",
    "read_csv(path_x=x_0) and 'x_0'": "read_csv(path_x=x_0) and 'x_0'",
    "1e-3 of 2-norms": "1e-3 of 2-norms",
}


@pytest.mark.parametrize("text", FORMULAS)
def test_formulas_of_docstrings_are_set(text):
    assert re.sub(":math:`(.*?)`", "«\\1»", as_formulas(text)) == FORMULAS[text]

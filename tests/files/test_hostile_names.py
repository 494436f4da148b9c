"""Names of a problem reach C, HTML, TOML, JSON and CSV as text: no character of them acts there."""

from __future__ import annotations

import csv
import json
import random
import subprocess
import tomllib
from html.parser import HTMLParser

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.generated import STRICT
from lin_freq_ocp.files.problem_file import problem_text
from lin_freq_ocp.files.solution_files import header, save_csv
from lin_freq_ocp.files.summary import head, to_json
from lin_freq_ocp.loop.embedded import markdown
from lin_freq_ocp.methods.native_code import compiler
from lin_freq_ocp.pages.explorer.server import page
from lin_freq_ocp.pages.explorer.session import Session

CODE = "*\\ int puts(const char *); __attribute__((constructor)) static void f(void) { puts(0); } /*"
PARTS = [
    CODE, "*/", "/*", "*\\", "\\", "??/", "//", "#include <x>", '"', "'", '"""', "'''", "`id`", "$(id)", "${HOME}",
    ";", "|", "&", "&lt;", "<script>alert(1)</script>", "</script>", "<!--", "-->", "]]>", "<img src=x onerror=f()>",
    "{{ 7 * 7 }}", "{% raw %}", "%s", "{0}", "[link](x)", "# head", "=1+1", "@x", "$x^{$", "\\input{x}", "é☃",
    "\U0001d54f", "]", "[", ",", "\\u202e",
]  # fmt: skip
STATES, CONTROLS, ROWS = 7, 2, 5
NAMES = 15 * (1 + STATES + CONTROLS + ROWS)


def hostile_problems() -> list[lfo.OptimalControlProblem]:
    """Return problems with 225 names, each of one to three hostile parts."""
    rng, found = random.Random(0), []
    names = ["".join(rng.choices(PARTS, k=rng.randint(1, 3))) + str(i) for i in range(NAMES)]
    rng_A = np.random.default_rng(0)
    A, B = 0.3 * rng_A.standard_normal((STATES, STATES)), rng_A.standard_normal((STATES, CONTROLS))
    count = 1 + STATES + CONTROLS + ROWS
    for name, *others in (names[i : i + count] for i in range(0, NAMES, count)):
        labels = others[:STATES], others[STATES : STATES + CONTROLS], others[STATES + CONTROLS :]
        plant = lfo.LinearDynamics(A, B, state_names=labels[0], control_names=labels[1])
        rows = [lfo.StageRows(D=[[1.0, 0.5]], e=[4.0], name=row) for row in labels[2]]
        cost = lfo.QuadraticCost(Q=np.eye(STATES), R=np.eye(CONTROLS))
        start = 0.1 * np.ones(STATES)
        found.append(
            lfo.OptimalControlProblem(plant, 2, cost, lfo.Box(-2, 2), initial_state=start, stage_rows=rows, name=name)
        )
    return found


PROBLEMS = hostile_problems()


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_generated_code_compiles_and_shows_them(tmp_path):
    comments = list[str]()
    for i, problem in enumerate(PROBLEMS[::3]):
        lfo.generate(lfo.RecedingHorizon(problem), tmp_path / str(i))
        source = (tmp_path / str(i) / "controller.h").read_text()
        comments.append(source[: source.index("*/") + 2])
        assert source[len(comments[-1]) :].startswith("\n#ifndef CONTROLLER_H\n")
        readme = (tmp_path / str(i) / "README.md").read_text()
        assert readme.startswith(f"# {markdown(problem.name)}, as C\n")
        assert "<script>" not in readme.replace("\\<", "")
    (tmp_path / "comments.c").write_text("\n".join([*comments, "int none;", ""]))
    command = [compiler(), *STRICT, "-fsyntax-only", "comments.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_problem_files_and_tables_keep_them(tmp_path):
    for problem in PROBLEMS:
        stated = tomllib.loads(problem_text(problem))
        assert stated["name"] == problem.name
        assert tuple(stated["dynamics"]["state_names"]) == problem.state_names
        assert [rows["name"] for rows in stated["stage_rows"]] == [rows.name for rows in problem.stage_rows]
        assert json.loads(to_json(head(problem)))["problem"]["name"] == problem.name
        save_csv(tmp_path / "run.csv", problem, lfo.simulate(problem, np.zeros((2, CONTROLS))))
        with open(tmp_path / "run.csv", newline="", encoding="utf-8") as file:
            heads = next(csv.reader(file))
        assert heads[1:] == [header(name) for name in (*problem.state_names, *problem.control_names)]


class Tags(HTMLParser):
    """The tags of a page with their attributes, and its texts."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.texts = list[tuple[str, tuple[str, ...]]](), list[str]()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        """Keep a tag with the names of its attributes."""
        self.tags.append((tag, tuple(name for name, _ in attrs)))

    def handle_data(self, data):
        """Keep a text."""
        self.texts.append(data)


def test_pages_have_the_tags_of_plain_names():
    plain, pages = set[tuple[tuple[str, tuple[str, ...]], ...]](), list[Tags]()
    for problem in PROBLEMS:
        pages.append(Tags(page(Session(problem))))
        plain.add(tuple(pages[-1].tags))
        assert any(problem.name in text for text in pages[-1].texts)
    assert len(plain) == 1  # the names differ, the tags do not

"""Hostile names of problems, signals and rows through every writer: no character of them acts in what is written."""

from __future__ import annotations

import csv
import json
import random
import subprocess
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.outcome import finding_of
from helpers.command_line import run
from helpers.generated import STRICT
from lin_freq_ocp.files import head, header, problem_text, save_csv, to_json
from lin_freq_ocp.loop import markdown
from lin_freq_ocp.methods import compiler
from lin_freq_ocp.pages import Session, page

CODE = "*\\ int puts(const char *); __attribute__((constructor)) static void f(void) { puts(0); } /*"
PARTS = [
    CODE, "*/", "/*", "*\\", "\\", "??/", "//", "#include <x>", '"', "'", '"""', "'''", "`id`", "$(id)", "${HOME}",
    ";", "|", "&", "&lt;", "<script>alert(1)</script>", "</script>", "<!--", "-->", "]]>", "<img src=x onerror=f()>",
    "{{ 7 * 7 }}", "{% raw %}", "%s", "{0}", "[link](x)", "# head", "=1+1", "@x", "$x^{$", "\\input{x}", "é☃",
    "\U0001d54f", "]", "[", ",", "\\u202e", "[red]", "[/]", " [N]", " [*/]", " [<b>]", ":smile:", "../x", "~",
]  # fmt: skip
STATES, CONTROLS, ROWS, STEPS = 3, 2, 2, 3
DRAWN = 10  # every so many problems are drawn, too: that takes a second

Writer = Callable[[lfo.OptimalControlProblem, Path], bool]
PageWriter = Callable[[lfo.OptimalControlProblem, Path], str]


@dataclass(frozen=True)
class Outcome:
    """The writers that one problem went through, and those that got its names wrong."""

    seed: int
    statuses: tuple[str, ...]
    wrong: tuple[str, ...]
    kind: str = "names"

    @property
    def passed(self) -> bool:
        """Whether all names came through."""
        return not self.wrong


def problem_of(names: list[str]) -> lfo.OptimalControlProblem:
    """Return the problem whose name, states, controls and rows have these names."""
    rng, (name, *others) = np.random.default_rng(0), names
    labels = others[:STATES], others[STATES : STATES + CONTROLS], others[STATES + CONTROLS :]
    A, B = 0.3 * rng.standard_normal((STATES, STATES)), rng.standard_normal((STATES, CONTROLS))
    plant = lfo.LinearDynamics(A, B, state_names=labels[0], control_names=labels[1])
    rows = [lfo.StageRows(D=[[1.0, 0.5]], e=[4.0], name=row) for row in labels[2]]
    cost = lfo.QuadraticCost(Q=np.eye(STATES), R=np.eye(CONTROLS))
    start = 0.1 * np.ones(STATES)
    return lfo.OptimalControlProblem(
        plant, STEPS, cost, lfo.Box(-2, 2), initial_state=start, stage_rows=rows, name=name
    )


def hostile_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a problem each of whose names has one to three hostile parts."""
    rng, count = random.Random(seed), 1 + STATES + CONTROLS + ROWS
    return problem_of(["".join(rng.choices(PARTS, k=rng.randint(1, 3))) + str(i) for i in range(count)])


def c_comment(problem: lfo.OptimalControlProblem, folder: Path) -> str:
    """Generate C, and return the comment that has the name; nothing of the name follows it."""
    lfo.generate(lfo.RecedingHorizon(problem), folder)
    source = (folder / "controller.h").read_text()
    comment = source[: source.index("*/") + 2]
    assert source[len(comment) :].startswith("\n#ifndef CONTROLLER_H\n")
    readme = (folder / "README.md").read_text()
    assert readme.startswith(f"# {markdown(problem.name)}, as C\n")
    assert "<script>" not in readme.replace("\\<", "")
    return comment


def compiles(comments: list[str], folder: Path) -> bool:
    """Whether a compiler takes these comments for comments."""
    (folder / "comments.c").write_text("\n".join([*comments, "int none;", ""]))
    command = [compiler() or "cc", *STRICT, "-fsyntax-only", "comments.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return (done.returncode, done.stderr) == (0, "")


def _comes_back_from_toml(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    (folder / "problem.toml").write_text(problem_text(problem), encoding="utf-8")
    stated = tomllib.loads(problem_text(problem))
    return _names(lfo.io.read_problem(folder / "problem.toml")) == _names(problem) and stated["name"] == problem.name


def _names(problem: lfo.OptimalControlProblem) -> tuple[str, ...]:
    return (problem.name, *problem.state_names, *problem.control_names, *(rows.name for rows in problem.stage_rows))


def _comes_back_from_json(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    return json.loads(to_json(head(problem)))["problem"]["name"] == problem.name


def _heads_of_csv(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    save_csv(folder / "run.csv", problem, lfo.simulate(problem, np.zeros((STEPS, CONTROLS))))
    with open(folder / "run.csv", newline="", encoding="utf-8") as file:
        heads = next(csv.reader(file))
    return heads[1:] == [header(name) for name in (*problem.state_names, *problem.control_names)]


def _shown_by_the_command(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    """Whether the command shows the name as it is, but for the breaks of its lines."""
    (folder / "problem.toml").write_text(problem_text(problem), encoding="utf-8")
    status, out, _ = run("show", str(folder / "problem.toml"))
    return status == 0 and "".join(problem.name.split()) in "".join(out.split())


def _proof_is_checked(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    lfo.solve(problem).write_proof(folder / "run.proof")
    return True  # the checker has read it


class Tags(HTMLParser):
    """The tags of a page with their attributes, its texts, and the kinds of tags in drawings (letters are shapes)."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.texts = list[tuple[str, tuple[str, ...]]](), list[str]()
        self.shapes, self._in_drawing = set[str](), False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        """Keep a tag with the names of its attributes, or its kind if it is within a drawing."""
        self._in_drawing |= tag == "svg"
        if self._in_drawing:
            self.shapes.add(tag)
        else:
            self.tags.append((tag, tuple(name for name, _ in attrs)))

    def handle_endtag(self, tag):
        """Notice the end of a drawing."""
        self._in_drawing &= tag != "svg"

    def handle_data(self, data):
        """Keep a text."""
        self.texts.append(data)


@cache
def plain_page(write: PageWriter) -> Tags:
    """Return the page of a problem with plain names."""
    with TemporaryDirectory() as folder:
        return Tags(write(problem_of([f"plain{i}" for i in range(1 + STATES + CONTROLS + ROWS)]), Path(folder)))


def _explorer(problem: lfo.OptimalControlProblem, folder: Path) -> str:
    return page(Session(problem))


def _loop_report(problem: lfo.OptimalControlProblem, folder: Path) -> str:
    return lfo.RecedingHorizon(problem).run(np.full(STATES, 0.1), 2).save(folder / "loop").read_text(encoding="utf-8")


def _has_plain_tags(write: PageWriter) -> Writer:
    def writer(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
        found, plain = Tags(write(problem, folder)), plain_page(write)
        same = found.tags == plain.tags and found.shapes <= plain.shapes
        return same and any(problem.name in text for text in found.texts)

    return writer


def _drawn(problem: lfo.OptimalControlProblem, folder: Path) -> bool:
    lfo.solve(problem).plot().figure.savefig(folder / "run.svg")
    plt.close("all")
    return (folder / "run.svg").stat().st_size > 0


WRITERS: dict[str, Writer] = {
    "C": lambda problem, folder: compiles([c_comment(problem, folder / "c")], folder),
    "TOML": _comes_back_from_toml,
    "JSON": _comes_back_from_json,
    "CSV": _heads_of_csv,
    "command": _shown_by_the_command,
    "proof": _proof_is_checked,
    "explorer": _has_plain_tags(_explorer),
}
SLOW_WRITERS: dict[str, Writer] = {"report": _has_plain_tags(_loop_report), "figure": _drawn}


def check(seed: int) -> Outcome:
    """Write a problem with hostile names by every writer."""
    problem, wrong = hostile_problem(seed), list[str]()
    writers = WRITERS | (SLOW_WRITERS if seed % DRAWN == 0 else {})
    for name, write in writers.items():
        with TemporaryDirectory() as folder:
            try:
                wrong += [] if write(problem, Path(folder)) else [name]
            except Exception as error:  # whatever a writer raises is the finding
                wrong.append(f"{name}: {finding_of(error)}")
    return Outcome(seed, tuple(writers), tuple(wrong))

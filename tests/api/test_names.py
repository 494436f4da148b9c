"""The public names: few at the top, all in namespaces, and nothing is imported before it is used."""

import ast
import subprocess
import sys
from importlib import import_module
from inspect import unwrap
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive

SLOW = (
    *(f"scipy.{part}" for part in "special optimize interpolate integrate io ndimage signal stats".split()),
    *("matplotlib", "cvxpy", "control", "pandas", "casadi"),
    "lin_freq_ocp.methods.structured.solver",
    *(f"lin_freq_ocp.{floor}.hybrid" for floor in ("transform", "program", "methods", "certificate", "solving")),
)
COMMAND_LINE = ("click", "rich", "jinja2")
COMMANDS = ("list", "show pendulum", "solve pendulum --json", "certify pendulum run.csv --json")
FILES = "lin_freq_ocp.files.problem_tables", "lin_freq_ocp.files.run_file", "lin_freq_ocp.uncertainty.protocol"
HULL = """
import numpy as np
from lin_freq_ocp.base import polyhedra
polyhedra.hull_weights(np.eye(1, 3), np.eye(3)[:0])
"""
RUN = "from lin_freq_ocp.cli import main\ntry: main({!r}.split())\nexcept SystemExit as end: assert not end.code"

STAGES = {
    "import lin_freq_ocp": (*SLOW, *COMMAND_LINE, "numpy", "scipy"),
    "import lin_freq_ocp.solving.solve": (*SLOW, *COMMAND_LINE),
    "import lin_freq_ocp as lfo; lfo.solve(lfo.library.pendulum()).to_csv('run.csv')": (*SLOW, *COMMAND_LINE),
    RUN.format("solve pendulum --json"): (*SLOW, *FILES),
    HULL: SLOW,
    **{RUN.format(command): SLOW for command in COMMANDS if command != "solve pendulum --json"},
}
"""What is not loaded after each statement; one process runs all of them. Those without modes load none of theirs."""


@expensive
def test_nothing_is_imported_before_it_is_used(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check = "import sys\n" + "".join(
        f"{statement}\nassert not (found := sys.modules.keys() & {set(names)}), ({statement!r}, found)\n"
        for statement, names in STAGES.items()
    )
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_names_at_the_top_are_few_and_all_exist():
    assert len(lfo.__all__) == len(set(lfo.__all__)) <= 65
    assert set(lfo.__all__) == set(lfo.NAMESPACES) | {name for name in lfo.__all__ if callable(getattr(lfo, name))}
    assert set(dir(lfo)) == {*lfo.__all__, "__version__"}


def test_type_checkers_see_the_names_that_are_imported():
    """The imports for type checkers and the table of modules are two lists of the same."""
    tree = ast.parse(Path(lfo.__file__).read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert seen.keys() == set(lfo.__all__)
    for name, module in seen.items():
        if module != "lin_freq_ocp":
            assert unwrap(getattr(import_module(module), name)) is unwrap(getattr(lfo, name))


@pytest.mark.parametrize("space", lfo.NAMESPACES)
def test_namespaces_have_what_they_list(space):
    module = getattr(lfo, space)
    assert all(hasattr(module, name) for name in getattr(module, "__all__", ["pendulum"]))


@pytest.mark.parametrize(
    ("name", "now"), [("Ball", "sets.Ball"), ("ProblemError", "errors.ProblemError"), ("pendulum", "library.pendulum")]
)
def test_a_name_that_moved_says_where_it_is(name, now):
    with pytest.raises(AttributeError, match=f"it is lin_freq_ocp.{now}$"):
        getattr(lfo, name)


def test_a_name_that_does_not_exist_is_no_attribute():
    with pytest.raises(AttributeError, match=r"^module 'lin_freq_ocp' has no attribute 'Bull'$"):
        lfo.Bull  # noqa: B018

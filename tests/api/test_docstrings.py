"""Docstrings of the public names: sections of numpydoc, and examples that are run."""

import doctest
import inspect
from itertools import pairwise

import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.seeds import expensive

SPACES = [name for name in lfo.NAMESPACES if name != "library"]
TOP = [name for name in lfo.__all__ if name not in lfo.NAMESPACES]
PUBLIC = {name: getattr(lfo, name) for name in TOP} | {
    f"{space}.{name}": getattr(getattr(lfo, space), name)
    for space in SPACES
    for name in getattr(lfo, space).__all__
    if name not in TOP
}
PUBLIC |= {f"library.{name}": function for name, function in lfo.library.PROBLEMS.items()}
FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}
CLASSES = {name: value for name, value in PUBLIC.items() if inspect.isclass(value)}
ERRORS = {name for name, value in CLASSES.items() if issubclass(value, (Exception, lfo.results.Status))}
LITERATURE = ("certify", "solve", "SpectralSolver", "library.crane", "library.switched_rotation")
"""Some of what rests on the paper or on literature."""
EXTRAS = {"from_casadi": "casadi", "results.Enclosure": "flint", "results.Result": "pandas"}
"""The modules of optional extras that examples need."""
COMPILED = {"generate", "results.GeneratedController"}


def sections(value):
    lines = inspect.getdoc(value).splitlines()
    return [line for line, rule in pairwise(lines) if rule and rule == "-" * len(line)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_say_what_they_take_return_and_raise(name):
    value = FUNCTIONS[name]
    returns = "Yields" if inspect.isgeneratorfunction(value) else "Returns"
    needed = [returns, "Raises", *(["Parameters"] if inspect.signature(value).parameters else [])]
    assert set(sections(value)) >= set(needed)


@pytest.mark.parametrize("name", sorted(CLASSES.keys() - ERRORS - {"Periodic", "sets.Everything"}))
def test_classes_say_what_they_hold(name):
    assert {"Parameters", "Attributes", "Methods"} & set(sections(CLASSES[name]))


@pytest.mark.parametrize("name", LITERATURE)
def test_what_rests_on_literature_cites_it(name):
    assert "References" in sections(PUBLIC[name])


@expensive
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=needs_kernel) if name in COMPILED else name for name in PUBLIC]
)
def test_public_names_have_an_example_that_runs(name, tmp_path, monkeypatch):
    if name in EXTRAS:
        pytest.importorskip(EXTRAS[name])
    monkeypatch.chdir(tmp_path)
    value = PUBLIC[name]
    found = doctest.DocTestFinder(recurse=False).find(value, name, globs={"lfo": lfo})
    results = [doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(one) for one in found]
    assert sum(one.failed for one in results) == 0
    assert sum(one.attempted for one in results) > 0

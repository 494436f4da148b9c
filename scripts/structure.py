"""Figures of the structure of the package, each with its limit; exit status 1 if one exceeds it. Part of .ci/run.

    python scripts/structure.py [FIGURE]

With the name of a figure, it lists every place that counts, for example `python scripts/structure.py "used once"`.

Code lines are lines with a token that is no comment and no docstring. Shipped lines are those of every language that a
wheel contains, lfo_check.py included: code that moves from Python to C remains in the count. A commit that raises a
limit names the feature, and the removal that pays for it. The linear part is base, formulas and the six
floors without their folders named hybrid, and the door is between the two. Circles of files count every import, within
functions and for type checkers too. Lines of functions are counted without their docstrings. isinstance on kinds of
dynamics and of terms is what their protocols replace. A solve is the second `lfo.solve(lfo.library.pendulum())` of a
process. Only shipped lines count lfo_check.py: it is a program of its own. Modules that tests import, and attributes
of these that they replace, show how far tests depend on where code stands: tests import from the doors of rooms, which
``__all__`` lists, and helpers.replacing replaces what a door lists. Each other module has a reason in PAST_DOORS.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import grimp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import lin_freq_ocp as lfo

PACKAGE = Path(lfo.__file__).parent
TESTS = Path(__file__).parent.parent / "tests"
CHECKER = "lfo_check.py"
LANGUAGES = {".c": r"/\*.*?\*/|//[^\n]*", ".h": r"/\*.*?\*/|//[^\n]*", ".css": r"/\*.*?\*/"}
LANGUAGES |= {".js": r"/\*.*?\*/|^\s*//[^\n]*", ".jinja": r"{#.*?#}|<!--.*?-->|/\*.*?\*/|^\s*//[^\n]*"}
"""The comments of each language but Python; in the last two, // may stand in a text."""

FLOORS = ("problem", "transform", "program", "methods", "certificate", "solving")
SHARE_SAID = "docstrings and comments [% of lines]"

LIMITS: dict[str, float] = {
    "shipped lines": 51_760,
    "code lines": 48_041,
    "code lines, linear part": 22_644,
    "code lines, hybrid": 8_773,
    SHARE_SAID: 19.5,  # at least
    "files": 342,
    "folders": 44,
    "folders at the root": 20,
    "modules at the root": 11,
    "names in __all__": 65,
    "lines of a file": 533,
    "lines of a function": 63,
    "functions used once [%]": 12.0,
    "files entered by a solve": 50,
    "functions entered by a solve": 378,
    "calls of a solve": 736,
    "modules that tests import": 49,
    "modules that tests import past a door": 12,
    "exceptions of doors, missing or unused": 0,
    "attributes that tests replace by path": 14,
    "private attributes that tests read": 10,
    "imports through the door": 0,
    "files in circles": 0,
    "class names used twice": 0,
    "constants of several values": 3,
    "file stems used three times": 4,
    "names of a lone participle": 0,
    "isinstance on dynamics": 1,
    "isinstance on terms": 5,
    "Any": 21,
}
"""At most, but for the share of docstrings and comments."""

PYTHONS = {"_replace", "_getframe"}
"""Attributes of named tuples and of sys: not private ones of ours."""

PAST_DOORS = {
    "one of two users of a function gets a wrong one, to show that the other does not share it": """
        certificate.hamiltonian certificate.rays methods.hybrid.search.branch_and_bound
        methods.hybrid.search.multipliers problem.measures program.units""",
    "the test is one of the whole module": """
        files.problem_tables methods.native_code""",
    "a name is replaced where one function looks it up": """
        explanation.explanation library.paper""",
    "names of one test": """
        methods.hybrid.search.path_native""",
    "a program of its own": """
        proof.lfo_check""",
}
"""Why tests import from inside a room, and which of its modules; a module that no test imports any more goes."""

ROOTS = {"dynamics": {"Dynamics"}, "terms": {"ConvexSet", "Cost", "FrequencyConstraint", "Penalty", "AffineMap"}}
"""Classes whose kinds have protocols in place of isinstance."""

LONE = frozenset(
    """behind beside within along later before after again apart above below near far over under without between inside
    outside alone beyond together made met held kept left put cut where once spread shut said told found given drawn
    taken known shown sought""".split()
)
"""Prepositions and irregular participles that are no name of a function; others are recognised by their ending."""

NO_CODE = frozenset(
    (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
)

Function = ast.FunctionDef | ast.AsyncFunctionDef


class Figure(NamedTuple):
    """A number, and the places that make it."""

    value: float
    places: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Module:
    """A file of the package: its path in there, its text and its syntax tree."""

    path: Path
    text: str
    tree: ast.Module

    @cached_property
    def lines(self) -> int:
        """Return the number of lines."""
        return len(self.text.splitlines())

    @cached_property
    def docstring_lines(self) -> set[int]:
        """Return the lines of docstrings, and of other strings that are statements."""
        strings = (node for node in ast.walk(self.tree) if isinstance(node, ast.Expr) and is_string(node.value))
        return {line for node in strings for line in range(node.lineno, (node.end_lineno or 0) + 1)}

    @cached_property
    def comments(self) -> int:
        """Return the number of lines that are a comment."""
        return sum(line.strip().startswith("#") for line in self.text.splitlines())

    @cached_property
    def code(self) -> int:
        """Return the number of code lines."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        spans = (range(token.start[0], token.end[0] + 1) for token in tokens if token.type not in NO_CODE)
        return len({line for span in spans for line in span} - self.docstring_lines)

    @cached_property
    def functions(self) -> list[tuple[Function, bool]]:
        """Return every function, and whether it is a method."""
        methods = {id(part) for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef) for part in node.body}
        return [(node, id(node) in methods) for node in ast.walk(self.tree) if isinstance(node, Function)]

    @property
    def part(self) -> str:
        """Return the part of the package: linear, hybrid, root, or one of the other folders."""
        folder = self.path.parts[0] if len(self.path.parts) > 1 else "root"
        if folder in FLOORS and "hybrid" in self.path.parts:
            return "hybrid"
        return "linear" if folder in (*FLOORS, "base", "formulas") else folder


def is_string(node: ast.expr) -> bool:
    """Whether an expression is a string."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def read_modules() -> list[Module]:
    """Return all modules of the package."""
    return [read_module(path) for path in sorted(PACKAGE.rglob("*.py")) if path.name != CHECKER]


def read_module(path: Path) -> Module:
    """Return a file of the package or of its tests."""
    text = path.read_text(encoding="utf-8")
    return Module(path.relative_to(PACKAGE if path.is_relative_to(PACKAGE) else TESTS), text, ast.parse(text))


def shipped_lines(modules: Sequence[Module]) -> Figure:
    """Return the code lines of each language that a wheel contains."""
    checker = next(PACKAGE.rglob(CHECKER))
    lines = Counter({"Python": sum(module.code for module in modules), CHECKER: read_module(checker).code})
    for path in PACKAGE.rglob("*"):
        if path.suffix in LANGUAGES:
            text = re.sub(LANGUAGES[path.suffix], "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
            lines[path.suffix[1:]] += sum(bool(line.strip()) for line in text.splitlines())
    return Figure(lines.total(), [f"{language} {count}" for language, count in lines.most_common()])


def sizes(modules: Sequence[Module]) -> Iterator[tuple[str, Figure]]:
    """Yield how large the package and its files are."""
    parts = Counter[str]()
    for module in modules:
        parts[module.part] += module.code
    yield "shipped lines", shipped_lines(modules)
    yield "code lines", Figure(parts.total(), [f"{part} {code}" for part, code in parts.most_common()])
    yield "code lines, linear part", Figure(parts["linear"])
    yield "code lines, hybrid", Figure(parts["hybrid"])
    said, lines = sum(len(one.docstring_lines) + one.comments for one in modules), sum(one.lines for one in modules)
    yield SHARE_SAID, Figure(round(100 * said / lines, 1))
    folders = {str(module.path.parent) for module in modules}
    yield "files", Figure(len(modules))
    yield "folders", Figure(len(folders))
    yield "folders at the root", counted(sorted({Path(folder).parts[0] for folder in folders - {"."}}))
    yield "modules at the root", counted([str(module.path) for module in modules if len(module.path.parts) == 1])
    yield "names in __all__", Figure(len(lfo.__all__))
    yield "lines of a file", longest((module.lines, str(module.path)) for module in modules)
    yield (
        "lines of a function",
        longest((own_lines(node), f"{module.path}: {node.name}") for module in modules for node, _ in module.functions),
    )


def counted(places: Sequence[str]) -> Figure:
    """Return how many places there are."""
    return Figure(len(places), places)


def longest(lengths: Iterable[tuple[int, str]]) -> Figure:
    """Return the greatest length, with the ten longest."""
    ranked = sorted(lengths, reverse=True)[:10]
    return Figure(ranked[0][0], [f"{place} {length}" for length, place in ranked])


def own_lines(node: Function) -> int:
    """Return the lines of a function without its docstring."""
    docstring = node.body[0] if ast.get_docstring(node) else None
    described = 0 if docstring is None else (docstring.end_lineno or 0) - docstring.lineno + 1
    return (node.end_lineno or 0) - node.lineno + 1 - described


def names(modules: Sequence[Module]) -> Iterator[tuple[str, Figure]]:
    """Yield which names are used once, twice or for several things, and which say nothing."""
    functions = [(module, node, method) for module in modules for node, method in module.functions]
    once = list(used_once(modules))
    yield "functions used once [%]", Figure(round(100 * len(once) / len(functions), 1), once)
    classes, constants = Counter[str](), defaultdict[str, set[str]](set)
    for module in modules:
        classes.update(node.name for node in ast.walk(module.tree) if isinstance(node, ast.ClassDef))
        for name, value in constants_of(module):
            constants[name].add(value)
    stems = Counter(module.path.stem for module in modules if module.path.stem != "__init__")
    yield "class names used twice", counted([name for name, times in classes.items() if times > 1])
    yield "constants of several values", counted([name for name, values in constants.items() if len(values) > 1])
    yield "file stems used three times", counted([stem for stem, times in stems.items() if times > 2])
    lone = [f"{module.path}: {node.name}" for module, node, method in functions if is_lone(node.name, method)]
    yield "names of a lone participle", counted(lone)


def used_once(modules: Sequence[Module]) -> Iterator[str]:
    """Yield the functions, and private methods, that their file uses once and no other imports."""
    imports = (node for module in modules for node in ast.walk(module.tree) if isinstance(node, ast.ImportFrom))
    imported = {alias.name for node in imports for alias in node.names}
    for module in modules:
        uses = Counter(
            node.id if isinstance(node, ast.Name) else node.attr
            for node in ast.walk(module.tree)
            if isinstance(node, (ast.Name, ast.Attribute)) and isinstance(node.ctx, ast.Load)
        )
        for node, method in module.functions:
            private, special = node.name.startswith("_"), node.name.startswith("__")
            inner = not node.decorator_list and not special and (private or not method)
            if inner and node.name not in imported and uses[node.name] == 1:
                yield f"{module.path}: {node.name}"


def constants_of(module: Module) -> Iterator[tuple[str, str]]:
    """Yield names in capitals with their values, where these are numbers or strings."""
    for node in module.tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, (ast.Constant, ast.UnaryOp)):
            for target in node.targets:
                if isinstance(target, ast.Name) and re.fullmatch(r"_?[A-Z][A-Z_0-9]+", target.id):
                    yield target.id, ast.unparse(node.value)


def is_lone(name: str, method: bool) -> bool:
    """Whether a name is a lone participle or preposition; public methods may be: properties and changed copies."""
    stem = name.strip("_")
    if "_" in stem or name.startswith("__") or (method and not name.startswith("_")):
        return False
    return stem in LONE or re.fullmatch(r"[a-z]{3,}(ed|ing)", stem) is not None


def contracts(modules: Sequence[Module]) -> Iterator[tuple[str, Figure]]:
    """Yield the places that violate the order of the floors or the protocols."""
    door = [
        f"{module.path}: {name}"
        for module in modules
        if module.part == "linear"
        for name in imported_modules(module.tree)
        if name.startswith("lin_freq_ocp.") and "hybrid" in name.split(".")
    ]
    yield "imports through the door", counted(door)
    yield "files in circles", counted(files_in_circles())
    for kind, roots in ROOTS.items():
        yield f"isinstance on {kind}", counted(list(checks_of(modules, kinds(modules, roots))))
    anything = [
        f"{module.path}:{node.lineno}"
        for module in modules
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Name) and node.id == "Any"
    ]
    yield "Any", counted(anything)


def doors() -> Iterator[tuple[str, Figure]]:
    """Yield what tests take from inside the package."""
    imported, past, replaced, private = Counter[str](), set[str](), list[str](), list[str]()
    for test in map(read_module, sorted(TESTS.rglob("*.py"))):
        taken = set(modules_of_test(test.tree))
        imported.update({name for name, _ in taken})
        past |= {name for name, inside in taken if inside}
        attributes = [node for node in ast.walk(test.tree) if isinstance(node, ast.Attribute)]
        own = {
            node.attr for node in attributes if isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
        }
        replaced += [f"{test.path}:{line}" for line in replaced_by_path(test.tree)]
        private += [
            f"{test.path}:{node.lineno} {node.attr}"
            for node in attributes
            if re.fullmatch(r"_[a-z]\w*[^_]", node.attr) and node.attr not in own | PYTHONS
        ]
    most = [f"{name} {times}" for name, times in imported.most_common()]
    excepted = {f"lin_freq_ocp.{name}": why for why, listed in PAST_DOORS.items() for name in listed.split()}
    yield "modules that tests import", Figure(len(imported), most)
    yield "modules that tests import past a door", counted([f"{name}: {excepted.get(name)}" for name in sorted(past)])
    yield "exceptions of doors, missing or unused", counted(sorted(past ^ set(excepted)))
    yield "attributes that tests replace by path", counted(replaced)
    yield "private attributes that tests read", counted(private)


def modules_of_test(tree: ast.Module) -> Iterator[tuple[str, bool]]:
    """Yield the modules of the package that a test imports or names, and whether it takes what no door lists."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, True) for alias in node.names if alias.name.startswith("lin_freq_ocp."))
        elif isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith("lin_freq_ocp."):
            for alias in node.names:
                name, listed = f"{node.module}.{alias.name}", alias.name in names_of_door(str(node.module))
                inside = is_module(name) and not listed
                yield (name, not names_of_door(name)) if inside else (str(node.module), not listed)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in {"setattr", "import_module"}:
            for text in (part.value for part in node.args[:1] if isinstance(part, ast.Constant)):
                if isinstance(text, str) and text.startswith("lin_freq_ocp."):
                    yield next(name for name in parents(text) if is_module(name)), True


def replaced_by_path(tree: ast.Module) -> Iterator[int]:
    """Yield the lines where a test replaces an attribute of a module of the package, which it names."""
    named = {"import_module"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith("lin_freq_ocp."):
            named |= {alias.asname or alias.name for alias in node.names if is_module(f"{node.module}.{alias.name}")}
        elif isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("import_module('lin_freq_ocp"):
            named |= {ast.unparse(target) for target in node.targets}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr") and node.args:
            whose = ast.unparse(node.args[0])
            if re.match(r"f?'lin_freq_ocp\.", whose) or re.split(r"[.(]", whose)[0] in named:
                yield node.lineno


def parents(name: str) -> Iterator[str]:
    """Yield a dotted name and those of its parents, the longest first."""
    while name:
        yield name
        name = name.rpartition(".")[0]


def is_module(name: str) -> bool:
    """Whether a dotted name is that of a module of the package."""
    path = PACKAGE.parent.joinpath(*name.split("."))
    return path.with_suffix(".py").exists() or (path / "__init__.py").exists()


@cache
def names_of_door(name: str) -> frozenset[str]:
    """Return the names that a module says that others may import, none if it says none."""
    module = import_module(name)
    return frozenset((*getattr(module, "__all__", ()), *getattr(module, "DOOR", ())))


def imported_modules(tree: ast.Module) -> Iterator[str]:
    """Yield the names of all modules that a module imports, or imports from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def files_in_circles() -> list[str]:
    """Return the modules that import themselves by way of others."""
    graph = grimp.build_graph("lin_freq_ocp", cache_dir=None)
    modules = sorted(graph.modules)
    number = {name: i for i, name in enumerate(modules)}
    pairs = [(number[a], number[b]) for a in modules for b in graph.find_modules_directly_imported_by(a)]
    rows, columns = np.array(pairs).T
    edges = csr_array((np.ones(len(pairs)), (rows, columns)), shape=(len(modules), len(modules)))
    _, group = connected_components(edges, connection="strong")
    members = np.bincount(group)
    return [name for name, i in number.items() if members[group[i]] > 1]


def kinds(modules: Sequence[Module], roots: set[str]) -> set[str]:
    """Return the names of the concrete classes of problem/ that derive from one of these classes."""
    classes = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for module in modules
        if module.path.parts[0] == "problem"
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef)
    }
    derived = set(roots)
    while new := {name for name, bases in classes.items() if bases & derived} - derived:
        derived |= new
    return {name for name in derived - roots if not classes[name] & {"ABC", "Protocol"}}


def checks_of(modules: Sequence[Module], classes: set[str]) -> Iterator[str]:
    """Yield the calls of isinstance that name one of these classes."""
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "isinstance":
                if any(isinstance(part, ast.Name) and part.id in classes for part in ast.walk(node.args[1])):
                    yield f"{module.path}:{node.lineno}"


def solve_figures() -> Iterator[tuple[str, Figure]]:
    """Yield the files, functions and calls of the package that a solve enters."""
    problem, calls = lfo.library.pendulum(), Counter[tuple[str, int, str]]()
    lfo.solve(problem)

    def count(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(PACKAGE)):
            calls[str(Path(code.co_filename).relative_to(PACKAGE)), code.co_firstlineno, code.co_name] += 1

    sys.setprofile(count)
    try:
        lfo.solve(problem)
    finally:
        sys.setprofile(None)
    yield "files entered by a solve", counted(sorted({file for file, _, _ in calls}))
    yield "functions entered by a solve", counted([f"{file}:{line} {name}" for file, line, name in sorted(calls)])
    often = [f"{file}:{line} {name} {times}" for (file, line, name), times in calls.most_common()]
    yield "calls of a solve", Figure(calls.total(), often)


def measure() -> dict[str, Figure]:
    """Return every figure, in the order of their limits."""
    modules = read_modules()
    figures = dict(part for group in (sizes, names, contracts) for part in group(modules))
    figures |= dict(doors()) | dict(solve_figures())
    return {name: figures[name] for name in LIMITS}


def main() -> int:
    """Print the figures, or the places of one; return 1 if one is beyond its limit."""
    figures, asked = measure(), " ".join(sys.argv[1:])
    if asked:
        for name in (name for name in figures if asked in name):
            print(f"{name}: {figures[name].value:g}", *figures[name].places, sep="\n  ")
        return 0
    table, exceeded = Table("figure", "is", "limit", "where", title="structure of the package"), False
    for name, (value, places) in figures.items():
        wrong = value < LIMITS[name] if name == SHARE_SAID else value > LIMITS[name]
        exceeded |= wrong
        where = ", ".join(places[:3]) + (" ..." if len(places) > 3 else "")
        table.add_row(name, f"{value:g}", f"{LIMITS[name]:g}", where, style="red" if wrong else None)
    Console().print(table)
    return int(exceeded)


if __name__ == "__main__":
    sys.exit(main())

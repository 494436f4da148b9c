"""A problem as a Python script of the package's classes, which builds an equal problem.

A call has the arguments that the problem file states as keys. What a problem file cannot state is refused here, too,
with the same field. Arrays are written out with all digits; an array of one value becomes ``np.full`` or ``np.zeros``,
and a diagonal matrix ``np.diag``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.files import problem_tables
from lin_freq_ocp.files.codec import TableRecord
from lin_freq_ocp.files.problem_tables import FORMULA_KEYS
from lin_freq_ocp.files.reading import FileTable, FileValue
from lin_freq_ocp.formulas.operations import LOOK_UP
from lin_freq_ocp.formulas.text import function_names
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for
from lin_freq_ocp.problem.ocp import OptimalControlProblem

WIDTH = 120  # columns of a line
INDENT = "    "
MOST_LINES = 16  # rows of a matrix, or arguments, that have a line each
SHORT = 4  # entries up to which an array of one value, or a range of bins, is written out

# The public module of each class, by the records of the problem file.
MODULES: Mapping[str, Iterable[TableRecord]] = {
    "lin_freq_ocp": [problem_tables.PROBLEM],
    "lin_freq_ocp.costs": [problem_tables.COST, *problem_tables.NORM_COSTS.records.values()],
    "lin_freq_ocp.dynamics": [
        *(problem_tables.AFFINE_MODE, problem_tables.SMOOTH_MODE),
        *problem_tables.RECORDS.values(),
    ],
    "lin_freq_ocp.sets": [*problem_tables.SETS.records.values(), *problem_tables.STAGE_ROWS.records.values()],
    "lin_freq_ocp.spectrum": [*problem_tables.SPECTRUM.records.values(), problem_tables.OUTPUTS],
}
LOOK_UP_IN = "def look_up(t, *values):\n    return t.look_up(values)\n"
NORM_OF = "def norm_of(*components):\n    return norm(components)\n"  # a text of formulas has norm(x_0, x_1)


@dataclass(frozen=True)
class Code:
    """An expression: a text alone, or parts between an opening and a closing bracket."""

    opening: str
    parts: tuple[Code, ...] = ()
    closing: str = ""

    @cached_property
    def flat(self) -> str:
        """Return the expression in one line."""
        return self.opening + ", ".join(part.flat for part in self.parts) + self.closing

    def named(self, name: str) -> Code:
        """Return the expression as a keyword argument, or as an assignment."""
        return Code(name + self.opening, self.parts, self.closing)

    def lines(self, indent: str = "", after: str = "") -> Iterator[str]:
        """Yield the expression in lines of at most WIDTH columns, as far as its smallest parts allow."""
        if not self.parts or len(indent) + len(self.flat) + len(after) <= WIDTH:
            yield indent + self.flat + after
            return
        yield indent + self.opening
        rows = len(self.parts) <= MOST_LINES and any(part.parts or "=" in part.opening for part in self.parts)
        if rows or any(len(indent + INDENT) + len(part.flat) >= WIDTH for part in self.parts):
            for part in self.parts:
                yield from part.lines(indent + INDENT, ",")
        else:  # as many as fit into a line
            line = indent + INDENT
            for part in self.parts:
                if line.strip() and len(line) + len(part.flat) + 1 > WIDTH:
                    yield line.rstrip()
                    line = indent + INDENT
                line += f"{part.flat}, "
            yield line.rstrip()
        yield indent + self.closing + after


class Symbol(str):
    """A text that is Python code."""


def problem_script(problem: OptimalControlProblem) -> str:
    """Return a script that builds the problem, and solves it when it is run.

    Raises
    ------
    ProblemError
        If a problem file cannot state a field.
    """
    problem_tables.PROBLEM.write("", problem)
    script = _Script()
    statement = "\n".join(script.expression(problem).named("problem = ").lines())
    script.names.add(("lin_freq_ocp", "solve"))
    imports = ["import numpy as np"] if "np." in statement else []
    for module in sorted({module for module, _ in script.names}, key=lambda module: (module != "numpy", module)):
        imports.append(f"from {module} import {', '.join(sorted(name for at, name in script.names if at == module))}")
    blocks = [
        f"# The problem {problem.name!r}, written by lin-freq-ocp show --python.",
        "\n".join(imports),
        "\n".join(script.definitions),
        statement,
        'if __name__ == "__main__":\n    print(solve(problem))',
    ]
    return "\n\n".join(block for block in blocks if block) + "\n"


@dataclass
class _Script:
    """The names that expressions use, as (module, name), and the definitions that precede them."""

    names: set[tuple[str, str]] = field(default_factory=set[tuple[str, str]])
    definitions: list[str] = field(default_factory=list[str])

    def expression(self, value: FileValue) -> Code:
        """Return the expression of a value that a problem file can state."""
        match value:
            case np.ndarray():
                return array_code(value)
            case list() | tuple():
                return Code("[", tuple(map(self.expression, value)), "]")
            case dict():
                entries = [self.expression(entry).named(f'"{key}": ') for key, entry in value.items()]
                return Code("{", tuple(entries), "}")
            case CostSum():
                return self._call("lin_freq_ocp.costs", "CostSum", [self.expression([value.quadratic, *value.norms])])
            case Dynamics():
                record = entry_for(problem_tables.RECORDS, value)
                return self._object(record, value if record.holds(value) else value.standard_form)
            case _:
                records = (record for group in MODULES.values() for record in group)
                record = next((record for record in records if record.holds(value)), None)
                return number_code(value) if record is None else self._object(record, value)

    def _object(self, record: TableRecord, value: FileValue) -> Code:
        """Return the call that builds an object, with the keys of its record as arguments."""
        entries = record.arguments(value)
        entries.pop("schema", None)
        if record is problem_tables.SMOOTH_MODES:
            entries = {"modes": self._modes(value.state_dim, entries), "state_dim": value.state_dim} | {
                name: entry for name, entry in entries.items() if name not in ("modes", "let")
            }
        if record is problem_tables.RESPONSE:
            given = {"G": value.G} | ({"offset": value.offset} if "offset_real" in entries else {})
            entries = given | {name: entry for name, entry in entries.items() if name[-5:] not in ("_real", "_imag")}
        module = next(name for name, records in MODULES.items() if any(known is record for known in records))
        constructor = record.constructor + (".from_continuous" if entries.pop("continuous", False) else "")
        return self._call(
            module, constructor, [self.expression(entry).named(f"{name}=") for name, entry in entries.items()]
        )

    def _call(self, module: str, name: str, parts: list[Code]) -> Code:
        self.names.add((module, name.partition(".")[0]))
        return Code(f"{name}(", tuple(parts), ")")

    def _modes(self, state_dim: int, entries: FileTable) -> list[FileValue]:
        """Define signals and shared subexpressions; return the modes with formulas as code."""
        self.names.add(("lin_freq_ocp", "signals"))
        control_dim: int = entries["control_dim"]
        x, u = (", ".join(f"{name}_{i}" for i in range(size)) for name, size in (("x", state_dim), ("u", control_dim)))
        self.definitions.append(f"[{x}], [{u}] = signals({state_dim}, {control_dim})")
        texts = [*(entries.get("let") or {}).values()]
        texts += [text for mode in entries["modes"] for key in FORMULA_KEYS for text in getattr(mode, key)]
        if any(re.search(r"\bt\b", text) for text in texts):
            self.names.add(("lin_freq_ocp.formulas", "time_of"))
            self.definitions.append(f"t = time_of(({state_dim}, {control_dim}))")
        self.definitions += [f"{name} = {self._formula(text)}" for name, text in (entries.get("let") or {}).items()]
        return [
            replace(mode, **{key: [Symbol(self._formula(text)) for text in getattr(mode, key)] for key in FORMULA_KEYS})
            for mode in entries["modes"]
        ]

    def _formula(self, text: str) -> str:
        """Return the code of a formula; its functions are those of NumPy, which formulas understand."""
        called = set(re.findall(r"\b([a-z]\w*)\(", text)) & {*function_names()} - {"abs"}
        if "norm" in called and NORM_OF not in self.definitions:
            self.names.add(("lin_freq_ocp", "norm"))
            self.definitions.insert(0, NORM_OF)
        if LOOK_UP in called and LOOK_UP_IN not in self.definitions:
            self.definitions.insert(0, LOOK_UP_IN)
        self.names |= {("numpy", name) for name in called - {"norm", LOOK_UP}}
        return re.sub(r"\bnorm\(", "norm_of(", text)


def number_code(value: object) -> Code:
    """Return a number, a text or a truth value as code; infinity is ``np.inf``."""
    if isinstance(value, Symbol):
        return Code(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return Code(f'"{value}"' if value.isprintable() and not {*value} & {'"', "\\"} else repr(value))
    if isinstance(value, float):
        return Code(repr(value).replace("inf", "np.inf"))
    if isinstance(value, complex):  # repr loses the sign of zeros
        signed = str(-0.0) in (str(value.real), str(value.imag))
        return Code(f"complex({value.real!r}, {value.imag!r})" if signed else repr(value).strip("()"))
    return Code(repr(value))


def array_code(array: Array) -> Code:
    """Return an array as code: a list with all digits, or the function of NumPy that makes it."""
    values = array.ravel()
    same = array.size > SHORT and array.tobytes() == np.full_like(array, values[0]).tobytes()
    if same or not array.size:
        shape = array.shape if array.ndim != 1 else array.size
        if not array.size or values.tobytes() == np.zeros_like(values).tobytes():
            return Code(f"np.zeros({shape})")
        return Code(f"np.full({shape}, {number_code(values[0]).flat})")
    if array.dtype.kind == "i" and array.size > SHORT and array.ndim == 1 and (np.diff(array) == 1).all():
        return Code(f"range({array[0]}, {array[-1] + 1})")
    if array.ndim == 2 and array.size > SHORT and array.tobytes() == np.diag(np.diagonal(array)).tobytes():
        return Code("np.diag(", (array_code(np.diagonal(array).copy()),), ")")
    if not array.ndim:
        return number_code(array.item())
    return Code("[", tuple(array_code(part) if array.ndim > 1 else number_code(part) for part in array), "]")

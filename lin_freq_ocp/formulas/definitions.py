"""Formulas as texts of moderate length: parts that are shared, long or nested deeply get names."""

from __future__ import annotations

import keyword
from collections import Counter
from collections.abc import Mapping, Sequence

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas.nodes import Formula, evaluated, in_order
from lin_freq_ocp.formulas.operations import OPERATIONS, SUM, VARIABLE, Notation
from lin_freq_ocp.formulas.text import formula_from_text, function_names, known_signals

LONGEST_TEXT = 1000  # characters of a formula that is written in full, even if parts of it repeat
SHORTEST_NAMED = 12  # characters: a shorter shared part is repeated, as a name would save nothing
DEEPEST = 20  # brackets within brackets of one text: parsers take some hundred
MOST_TERMS = 50  # terms of a sum in one text: parsers nest them
EXACT = Notation(repr)  # numbers to the last bit


def defined(field: str, given: object, dimensions: tuple[int, int]) -> dict[str, Formula]:
    """Return signals and named formulas, each of which may use those before it; errors call the table ``field``."""
    if not isinstance(given, Mapping):
        raise ProblemError(field, brief(given), 'a table of formulas by name, as let = {drag = "x_1 * abs(x_1)"}')
    known = known_signals(dimensions)
    for name, text in given.items():
        entry = f"{field}.{name}"
        if not isinstance(name, str) or not name.isidentifier() or not name.isascii() or keyword.iskeyword(name):
            raise ProblemError(field, brief(name), "names of letters, digits and _, which begin with no digit")
        if name in known or name in function_names():
            raise ProblemError(entry, "the name of a signal or a function", "another name")
        if isinstance(text, bool) or not isinstance(text, (str, int, float)):
            raise ProblemError(entry, brief(text), "a formula in quotes, or a number")
        known[name] = formula_from_text(entry, str(text), dimensions, known)
    return known


def with_definitions(formulas: Sequence[Formula]) -> tuple[list[str], dict[str, str]]:
    """Return the texts of formulas, and the named formulas that they use, each after those that it uses.

    Formulas of up to ``LONGEST_TEXT`` characters are written as they stand; as soon as one is longer, what stands in
    several of them is written once. So the length of all texts grows with the number of nodes.

    Formulas are those of ``signals``, without other functions.
    """
    order = in_order(formulas)
    uses = Counter(argument for one in order for argument in one.arguments) + Counter(formulas)
    shared = {one for one, count in uses.items() if count > 1} if _longest(formulas) > LONGEST_TEXT else set()
    writer = _Writer(shared)
    for one in order:
        writer.add(one)
    return [writer.part(one)[0] for one in formulas], writer.definitions


def _longest(formulas: Sequence[Formula]) -> int:
    """Return the approximate number of characters of the longest formula as it stands."""

    def length(one: Formula, arguments: list[int]) -> int:
        numbers = 0 if one.kind == VARIABLE else sum(len(f"{value!r}") + 3 for value in one.data)
        return 4 + numbers + sum(arguments) + 2 * len(arguments)

    return max(evaluated(formulas, length), default=0)


class _Writer:
    """Writes nodes, arguments before what is made of them."""

    def __init__(self, shared: set[Formula]):
        self.definitions: dict[str, str] = {}
        self._shared = shared
        self._written: dict[Formula, tuple[str, int]] = {}

    def add(self, one: Formula) -> None:
        """Write one node."""
        parts = [self.part(argument) for argument in one.arguments]
        texts = [text for text, _ in parts]
        if one.kind == SUM and len(texts) > MOST_TERMS:
            self._written[one] = self._long_sum(one, texts), 1
            return
        whole = {i for i, (_, depth) in enumerate(parts) if depth == 0}
        depth = 0 if one.kind == VARIABLE else 1 + max((depth for _, depth in parts), default=0)
        self._written[one] = OPERATIONS[one.kind].text(one, texts, EXACT, whole), depth

    def part(self, one: Formula) -> tuple[str, int]:
        """Return how a node stands in another text, and how deeply it is nested: 0 for a name."""
        text, depth = self._written[one]
        large = len(text) > LONGEST_TEXT or depth > DEEPEST
        if depth and (large or (one in self._shared and len(text) >= SHORTEST_NAMED)):
            self._written[one] = self._named(text), 0
        return self._written[one]

    def _long_sum(self, one: Formula, texts: Sequence[str]) -> str:
        """Return the names of parts of a sum, added up: what is read makes one sum of them again."""
        names: list[str] = []
        for first in range(0, len(texts), MOST_TERMS):
            chosen = slice(first, first + MOST_TERMS)
            last = first + MOST_TERMS >= len(texts)
            factors = (*one.data[:-1][chosen], one.data[-1] if last else 0.0)
            some = Formula(one.dimensions, SUM, one.arguments[chosen], factors)
            whole = {i for i, argument in enumerate(some.arguments) if not self._written[argument][1]}
            names.append(self._named(OPERATIONS[SUM].text(some, texts[chosen], EXACT, whole)))
        while len(names) > MOST_TERMS:
            names = [
                self._named(" + ".join(names[first : first + MOST_TERMS])) for first in range(0, len(names), MOST_TERMS)
            ]
        return " + ".join(names)

    def _named(self, text: str) -> str:
        name = f"w_{len(self.definitions)}"
        self.definitions[name] = text
        return name

"""Formulas in docstrings, written for terminals, as LaTeX for the site.

A formula is the longest run of text that is a relation or an expression of the grammar below and has a mark of
mathematics: an index, a power, a comparison, a Greek letter or a function. What does not fit remains text.

    relation = sum {("=" | "<=" | ...) sum}        sum = product {("+" | "-") product}
    product = power {["*" | "/"] power}            power = atom ["^" atom]
    atom = number | name | function "(" ... ")" | "(" relation {"," relation} ")" | "|" sum "|" | "sum_t" product
"""

from __future__ import annotations

import re
from collections.abc import Callable

GREEK = "alpha beta gamma delta eta theta lambda mu nu xi pi rho sigma tau phi psi zeta omega".split()
FUNCTIONS = set("exp sqrt cos sin tan log max min Re conj diag ceil sinc irfft".split())
KNOWN = {"cos", "sin", "tan", "log", "max", "min", "exp"}  # to LaTeX
QUANTITIES = set(
    """limit percent reference hover angle rate speed position price weight phase lower upper centre radius offset scale
    stimulation raster amplitude constant base damping input slack terminal coefficients response slew_rate band_level
    terminal_weight limit_db db oversampling""".split()
)
HATS = {"uhat", "xhat", "Ghat"}
SPELT = {"iwt": r"i\,w\,t"}
RELATIONS = {"<=": r"\le", ">=": r"\ge", "=": "=", "<": "<", ">": ">", "in": r"\in", "..": r",\dots,"}
QUOTIENTS = {"*": r"\cdot", "/": "/", "//": "/"}
BRACKETS = {"(": ")", "|": "|", "{": "}", "<": ">"}
LATEX = {"{": r"\{", "}": r"\}", "<": r"\langle ", ">": r"\rangle"}
OPERATORS = {*RELATIONS, *"+*/^"}
WORDS_ALONE = {"a", "A", "I"}  # also words of English: part of a formula only next to an operator
NAME = r"[A-Za-z]+\d*(?:_(?:\{[^}]*\}|[A-Za-z0-9]+(?:,[a-z])?))?'*"
TOKEN = re.compile(rf"(?P<number>\d+(?:\.\d+)?)|(?P<name>{NAME})|<=|>=|\.\.|//|\S")
BREAK = "\0"  # where a long formula may be broken
LONGEST = 40  # characters of LaTeX between two breaks
BEFORE = "([{-/ \n"  # a role may follow these
UNITS = re.compile(r"\b((?:m|mm|km|kg|N|Nm|rad|mT|T)[/ ](?:m )?(?:m|mm|s|ms))\^([23])")
SUPERSCRIPT = {"2": "\N{SUPERSCRIPT TWO}", "3": "\N{SUPERSCRIPT THREE}"}
Parsed = tuple[str, int, bool]  # LaTeX, the position behind, and whether it has a mark of mathematics


class NoFormulaError(Exception):
    """The text does not go on as a formula."""


class Parser:
    """The grammar of the module, from a position of a text."""

    def __init__(self, text: str):
        self.text = text

    def token(self, at: int) -> tuple[str, str, int, int]:
        """Return kind, text, start and end of the next token; blanks are skipped, but no empty line."""
        blank = re.compile(r"[ ]*(?:\n[ ]*(?!\n))?").match(self.text, at)
        found = TOKEN.match(self.text, blank.end() if blank else at)
        return (found.lastgroup or "mark", found[0], found.start(), found.end()) if found else ("end", "", at, at)

    def chain(self, at: int, part: Callable[[int], Parsed], marks: dict[str, str], marked: bool) -> Parsed:
        """Parse parts between marks; a mark without a part behind it is left to the text."""
        latex, end, found = part(at)
        while True:
            _, mark, start, after = self.token(end)
            spaced = start > end, self.text[after : after + 1].isspace()
            if mark not in marks or (mark == "-" and spaced[0] != spaced[1]):
                return latex, end, found
            if mark == "in" and not re.match(r" (?:[B-HJ-Z]\b|[B-Z][_^]|\{)", self.text[after:]):
                return latex, end, found
            try:
                more, behind, trigger = part(after)
            except NoFormulaError:
                return latex, end, found
            gap = BREAK if mark in RELATIONS or mark in "+-*" else " "
            latex = rf"\lfloor {latex} / {more} \rfloor" if mark == "//" else f"{latex}{gap}{marks[mark]} {more}"
            end, found = behind, found or trigger or (marked and mark != "=")

    def relation(self, at: int) -> Parsed:
        """Parse sums between comparisons."""
        return self.chain(at, self.sum, RELATIONS, True)

    def sum(self, at: int) -> Parsed:
        """Parse products between signs."""
        _, mark, _, end = self.token(at)
        sign, at = ("-", end) if mark == "-" and not self.text[end : end + 1].isspace() else ("", at)
        latex, end, found = self.chain(at, self.product, {"+": "+", "-": "-"}, False)
        return sign + latex, end, found

    def product(self, at: int) -> Parsed:
        """Parse powers one after another, or between * and /."""
        latex, end, found = self.chain(at, self.power, QUOTIENTS, False)
        while True:
            try:
                kind, word, start, after = self.token(end)
                lone = word in WORDS_ALONE and self.token(after)[1] not in {*OPERATORS, *")-"}
                tight = start == end and not (word == "(" or (kind == "name" and self.text[end - 1] == "'"))
                if tight or lone or kind == "number" or word in "-" or word == "in":
                    return latex, end, found
                more, behind, trigger = self.chain(end, self.power, QUOTIENTS, False)
                if start > end and word == "(" and "," in more and not trigger:  # a shape
                    return latex, end, found
                space = "" if start == end else r"\,"
                latex, end, found = f"{latex}{space}{more}", behind, found or trigger
            except NoFormulaError:
                return latex, end, found

    def power(self, at: int) -> Parsed:
        """Parse an atom and its exponent."""
        latex, end, found = self.atom(at)
        if self.text[end : end + 1] == "^":
            _, sign, _, behind = self.token(end + 1)
            exponent, end, _ = self.atom(behind if sign in "-+" else end + 1)
            exponent = exponent[1:-1] if exponent.startswith("(") else exponent
            return f"{latex}^{{{sign if sign in '-+' else ''}{exponent}}}", end, True
        return latex, end, found

    def atom(self, at: int) -> Parsed:
        """Parse a number, a name, a function, or what brackets or bars enclose."""
        kind, word, _, end = self.token(at)
        if kind == "number":
            return word, end, False
        if kind == "name":
            return self.name(word, end)
        closing = BRACKETS.get(word)
        if closing is None or self.text[end : end + 1].isspace():
            raise NoFormulaError
        inner, end, found = self.listed(end, closing)
        primes = re.compile("'*").match(self.text, end)
        enclosed = f"{LATEX.get(word, word)}{inner}{LATEX.get(closing, closing)}{primes[0] if primes else ''}"
        return enclosed, primes.end() if primes else end, found or word in "|<{"

    def listed(self, at: int, closing: str) -> Parsed:
        """Parse relations between commas up to the closing bracket."""
        latex, end, found = self.chain(at, self.relation if closing != "|" else self.sum, {",": ","}, False)
        _, mark, start, after = self.token(end)
        if closing == "}" and mark == ":":
            condition, end, found = self.relation(after)
            latex, (_, mark, start, after) = rf"{latex} : {condition}", self.token(end)
        if mark != closing or (closing == "|" and start != end):
            raise NoFormulaError
        return latex.replace(BREAK, " "), after, found

    def name(self, word: str, end: int) -> Parsed:
        """Parse a letter, a Greek letter, an indexed one, or a function of what is in brackets behind it."""
        stem, _, index = word.rstrip("'").partition("_")
        primes, bracket = "'" * (len(word) - len(word.rstrip("'"))), self.text[end : end + 1] == "("
        if stem in ("sum", "max", "min") and index:
            summed, end, _ = self.product(end)
            lower = re.sub(r"<=", r"\\le ", index.strip("{}"))
            return rf"\{stem}_{{{lower}}} {summed}", end, True
        if stem in FUNCTIONS and bracket and not index:
            inner, end, _ = self.listed(end + 1, ")")
            if stem == "sqrt":
                return rf"\sqrt{{{inner}}}", end, True
            head = rf"\{stem}" if stem in KNOWN else rf"\operatorname{{{stem}}}"
            return f"{head}({inner})", end, True
        if word in SPELT:
            return SPELT[word], end, True
        if word in ("sum", "Re") and self.text[end : end + 1] == " ":
            summed, end, _ = self.product(end)
            return rf"\sum {summed}" if word == "sum" else rf"\operatorname{{Re}} {summed}", end, True
        if word in QUANTITIES or (stem in QUANTITIES and len(index) == 1):
            before = self.text[: end - len(word)].rstrip()[-1:]
            if word == stem and self.token(end)[1] not in {*OPERATORS, ")"} and before not in {*"=*/+-(<>|^"}:
                raise NoFormulaError
            of = f"_{{{index}}}" if word not in QUANTITIES else ""
            return rf"\text{{{(word if not of else stem).replace('_', ' ')}}}{of}", end, bool(of)
        hat = stem in HATS
        letter = stem[0] if hat else stem
        if len(letter.rstrip("0123456789")) > 1 and letter not in GREEK:
            raise NoFormulaError
        digits = letter.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz")
        latex = rf"\{letter}" if letter in GREEK else letter[: len(letter) - len(digits)]
        latex, index = rf"\hat{{{latex}}}" if hat else latex, index.strip("{}") or digits
        index = ",".join(rf"\{one}" if one in GREEK else _upright(one) for one in index.split(","))
        latex += primes + (f"_{{{index}}}" if index else "")
        if self.text[end : end + 3] in ("+ =", "+ >"):  # the next value
            return f"{latex}^+", end + 1, True
        return latex, end, bool(index) or letter in GREEK


def _upright(index: str) -> str:
    """Return an index, upright if it is a word."""
    return rf"\mathrm{{{index}}}" if len(index) > 1 and index.isalpha() else index


def _roles(latex: str) -> str:
    """Return a formula as roles that lines of a narrow page may separate."""
    first, *more = latex.split(BREAK)
    pieces = [first]
    for piece in more:
        if len(pieces[-1]) + len(piece) < LONGEST:
            pieces[-1] += f" {piece}"
        else:
            pieces.append(f"{{}}{piece}")
    return " ".join(f":math:`{piece}`" for piece in pieces)


def with_superscripts(text: str) -> str:
    """Return a text with the powers of its units raised."""
    return UNITS.sub(lambda unit: unit[1] + SUPERSCRIPT[unit[2]], text)


def as_formulas(text: str, plain: Callable[[str], str] = lambda text: text) -> str:
    """Return a text with its formulas as roles of reStructuredText; ``plain`` is applied to the rest."""
    text = with_superscripts(text)
    parser, parts, at, last = Parser(text), list[str](), 0, 0
    while at < len(text):
        before = text[max(at - 2, 0) : at]
        if before and (before[-1] not in BEFORE or (before[-1] == "(" and before[0].isalnum())):
            at += 1
            continue
        try:
            if text[at].isspace() or text[at] in "+*/=>,":
                raise NoFormulaError
            latex, end, found = parser.relation(at)
            first = parser.token(at)[1]
            alone = first in WORDS_ALONE and parser.token(parser.token(at)[3])[1] not in {*RELATIONS, *"+*/^-("}
            behind = text[end : end + 1]
            if not found or alone or behind.isalnum() or behind in ("_", "`", '"', "'", "[", "(", "/", "^"):
                raise NoFormulaError
        except (NoFormulaError, RecursionError):
            at += 1
            continue
        parts += [plain(text[last:at]), _roles(latex), "" if behind in " \n.,;:)" else "\\ "]
        at = last = end
    return "".join(parts) + plain(text[last:])

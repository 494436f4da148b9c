"""Formulas of docstrings, which are written for terminals, as LaTeX for the site.

A formula is the longest text of this grammar that has a mark of mathematics: an index, a power, a comparison, a Greek
letter, bars or a function. All other text stays as it is.

    relation = sum {("=" | "<=" | "in" | ...) sum}
    sum      = ["-"] product {("+" | "-") product}
    product  = quotient {quotient}
    quotient = power {("*" | "/" | "//") power}
    power    = atom ["^" ["+" | "-"] atom]
    atom     = number | name | "(" items ")" | "|" items "|" | "<" items ">" | "{" items [":" relation] "}"
    items    = relation {"," relation}
    name     = function "(" items ")" | ("sum_t" | "max_t" | "sum" | ...) product | quantity | letter
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

GREEK = "alpha beta gamma delta eta theta lambda mu nu xi pi rho sigma tau phi psi zeta omega".split()
FUNCTIONS = set("exp sqrt cos sin tan log max min Re conj diag ceil sinc irfft".split())
KNOWN = {"cos", "sin", "tan", "log", "max", "min", "exp"}  # the functions that LaTeX has
QUANTITIES = set(
    """limit percent reference hover angle rate speed position price weight phase lower upper centre radius offset scale
    stimulation raster amplitude constant base damping input slack terminal coefficients response slew_rate band_level
    terminal_weight limit_db db oversampling""".split()
)
HATS = {"uhat", "xhat", "Ghat"}
WITHOUT_BLANKS = {"iwt": r"i\,w\,t"}
WORDS_ALONE = {"a", "A", "I"}  # also words of English: part of a formula only next to an operator

BREAK = "\0"  # where a long formula may be broken
LONGEST = 40  # characters of LaTeX between two breaks
COMPARISONS = {"<=": r"\le", ">=": r"\ge", "<": "<", ">": ">", "in": r"\in", "..": r",\dots,"}
RELATIONS = {mark: BREAK + latex for mark, latex in {**COMPARISONS, "=": "="}.items()}
SIGNS = {mark: BREAK + mark for mark in "+-"}
QUOTIENTS = {"*": BREAK + r"\cdot", "/": " /", "//": " //"}
COMMA = {",": " ,"}
OPERATORS = {*RELATIONS, *"+*/^"}
BRACKETS = {"(": ")", "|": "|", "{": "}", "<": ">"}
BRACKETS_IN_LATEX = {"{": r"\{", "}": r"\}", "<": r"\langle ", ">": r"\rangle"}

NAME = r"[A-Za-z]+\d*(?:_(?:\{[^}]*\}|[A-Za-z0-9]+(?:,[a-z])?))?'*"
TOKEN = re.compile(rf"(?P<number>\d+(?:\.\d+)?)|(?P<name>{NAME})|<=|>=|\.\.|//|\S")
BLANK = re.compile(r"[ ]*(?:\n[ ]*(?!\n))?")  # no empty line
SET = re.compile(r" (?:[B-HJ-Z]\b|[B-Z][_^]|\{)")  # what follows "in" in a formula
NEVER_FIRST = "+*/=>,"
MAY_PRECEDE = "([{-/ \n"  # reStructuredText knows a role after these
MAY_NOT_FOLLOW = {"_", "`", '"', "'", "[", "(", "/", "^"}
UNITS = re.compile(r"\b((?:m|mm|km|kg|N|Nm|rad|mT|T)[/ ](?:m )?(?:m|mm|s|ms))\^([23])")
SUPERSCRIPT = {"2": "\N{SUPERSCRIPT TWO}", "3": "\N{SUPERSCRIPT THREE}"}


class NoFormulaError(Exception):
    """No part of a formula begins here."""


class Token(NamedTuple):
    """A number, a name or a mark, and its place in the text; the text is empty at the end."""

    kind: str
    text: str
    start: int
    end: int


class Parsed(NamedTuple):
    """A part of a formula in LaTeX, the place where it ends, and whether it has a mark of mathematics."""

    latex: str
    end: int
    marked: bool


class Parser:
    """The grammar of the module. A rule parses from a place of the text on, or raises NoFormulaError."""

    def __init__(self, text: str):
        self.text = text

    def formula(self, at: int) -> Parsed:
        """Parse a relation that has a mark of mathematics and neither begins nor ends within a word."""
        before, first = self.text[max(at - 2, 0) : at], self.token(at)
        of_call = before[-1:] == "(" and before[0].isalnum()
        if (before and before[-1] not in MAY_PRECEDE) or of_call or first.start > at or self.text[at] in NEVER_FIRST:
            raise NoFormulaError
        parsed = self.relation(at)
        alone = first.text in WORDS_ALONE and self.token(first.end).text not in {*OPERATORS, *"-("}
        after = self.character(parsed.end)
        if alone or not parsed.marked or after.isalnum() or after in MAY_NOT_FOLLOW:
            raise NoFormulaError
        return parsed

    def relation(self, at: int) -> Parsed:
        """Parse sums with comparisons between them."""
        return self.chain(at, self.sum, RELATIONS)

    def sum(self, at: int) -> Parsed:
        """Parse products with signs between them."""
        first = self.token(at)
        negative = first.text == "-" and not self.character(first.end).isspace()
        latex, end, marked = self.chain(first.end if negative else at, self.product, SIGNS)
        return Parsed(f"-{latex}" if negative else latex, end, marked)

    def product(self, at: int) -> Parsed:
        """Parse factors that follow each other without a sign."""
        latex, end, marked = self.quotient(at)
        while self.is_factor(first := self.token(end), end):
            try:
                factor = self.quotient(end)
            except NoFormulaError:
                break
            if first.start > end and first.text == "(" and "," in factor.latex and not factor.marked:  # a shape
                break
            space = r"\," if first.start > end else ""
            latex, end, marked = f"{latex}{space}{factor.latex}", factor.end, marked or factor.marked
        return Parsed(latex, end, marked)

    def is_factor(self, first: Token, end: int) -> bool:
        """Whether a token begins another factor of a product that ends at ``end``."""
        if first.kind == "number" or first.text in ("", "-", "in"):
            return False
        if first.text in WORDS_ALONE and self.token(first.end).text not in {*OPERATORS, *")-"}:
            return False
        return first.start > end or first.text == "(" or (first.kind == "name" and self.text[end - 1] == "'")

    def quotient(self, at: int) -> Parsed:
        """Parse powers with "*" or "/" between them."""
        return self.chain(at, self.power, QUOTIENTS)

    def power(self, at: int) -> Parsed:
        """Parse an atom and its exponent, if there is one."""
        base = self.atom(at)
        if self.character(base.end) != "^":
            return base
        sign = self.token(base.end + 1)
        signed = sign.text in ("+", "-")
        latex, end, _ = self.atom(sign.end if signed else base.end + 1)
        latex = latex[1:-1] if latex.startswith("(") else latex
        return Parsed(f"{base.latex}^{{{sign.text if signed else ''}{latex}}}", end, True)

    def atom(self, at: int) -> Parsed:
        """Parse a number, a name, or what brackets or bars enclose."""
        kind, word, _, end = self.token(at)
        if kind == "number":
            return Parsed(word, end, False)
        if kind == "name":
            return self.name(word, end)
        closing = BRACKETS.get(word)
        if closing is None or self.character(end).isspace():
            raise NoFormulaError
        latex, end, marked = self.items(end, closing)
        left, right = (BRACKETS_IN_LATEX.get(bracket, bracket) for bracket in (word, closing))
        primes = self.primes(end)
        return Parsed(f"{left}{latex}{right}{primes}", end + len(primes), marked or word != "(")

    def items(self, at: int, closing: str) -> Parsed:
        """Parse what brackets or bars enclose, and the closing one."""
        latex, end, marked = self.chain(at, self.sum if closing == "|" else self.relation, COMMA)
        last = self.token(end)
        if closing == "}" and last.text == ":":
            condition, end, marked = self.relation(last.end)
            latex, last = rf"{latex} : {condition}", self.token(end)
        if last.text != closing or (closing == "|" and last.start > end):
            raise NoFormulaError
        return Parsed(latex.replace(BREAK, " "), last.end, marked)

    def name(self, word: str, end: int) -> Parsed:
        """Parse what a name begins, which ends at ``end``: a function, a sum, a quantity or a letter."""
        stem, _, index = word.rstrip("'").partition("_")
        if index and stem in ("sum", "max", "min"):
            lower = index.strip("{}").replace("<=", r"\le ")
            latex, end, _ = self.product(end)
            return Parsed(rf"\{stem}_{{{lower}}} {latex}", end, True)
        if stem in FUNCTIONS and not index and self.character(end) == "(":
            latex, end, _ = self.items(end + 1, ")")
            head = rf"\{stem}" if stem in KNOWN else rf"\operatorname{{{stem}}}"
            return Parsed(rf"\sqrt{{{latex}}}" if stem == "sqrt" else f"{head}({latex})", end, True)
        if word in WITHOUT_BLANKS:
            return Parsed(WITHOUT_BLANKS[word], end, True)
        if word in ("sum", "Re") and self.character(end) == " ":
            latex, end, _ = self.product(end)
            return Parsed(rf"\sum {latex}" if word == "sum" else rf"\operatorname{{Re}} {latex}", end, True)
        if word in QUANTITIES or (stem in QUANTITIES and len(index) == 1):
            return self.quantity(word, end)
        return self.letter(stem, index, word[len(word.rstrip("'")) :], end)

    def quantity(self, word: str, end: int) -> Parsed:
        """Parse a word that stands for a number: with an index, or next to an operator."""
        if word in QUANTITIES:
            before, after = self.text[: end - len(word)].rstrip()[-1:], self.token(end).text
            if "_" not in word and after not in {*OPERATORS, ")"} and before not in {*"=*/+-(<>|^"}:
                raise NoFormulaError
            return Parsed(rf"\text{{{word.replace('_', ' ')}}}", end, False)
        stem, _, index = word.rstrip("'").partition("_")
        return Parsed(rf"\text{{{stem}}}_{{{index}}}", end, True)

    def letter(self, stem: str, index: str, primes: str, end: int) -> Parsed:
        """Parse a Latin or Greek letter with its index: x_t, x2, xhat_k, lambda."""
        letter = stem.rstrip("0123456789")
        digits = stem[len(letter) :]
        greek = stem in GREEK
        if stem in HATS:
            latex, digits = rf"\hat{{{stem[0]}}}", ""
        elif greek or len(letter) == 1:
            latex = rf"\{letter}" if greek else letter
        else:
            raise NoFormulaError
        index = ",".join(map(_index_in_latex, (index.strip("{}") or digits).split(",")))
        latex += primes + (f"_{{{index}}}" if index else "")
        if self.text[end : end + 3] in ("+ =", "+ >"):  # the next value
            return Parsed(f"{latex}^+", end + 1, True)
        return Parsed(latex, end, bool(index) or greek)

    def chain(self, at: int, part: Callable[[int], Parsed], joints: Mapping[str, str]) -> Parsed:
        """Parse parts between joints; a joint that no part follows is left to the text."""
        latex, end, marked = part(at)
        while (joint := self.token(end)).text in joints and self.joins(joint, end):
            try:
                more = part(joint.end)
            except NoFormulaError:
                break
            if joint.text == "//":
                latex = rf"\lfloor {latex} / {more.latex} \rfloor"
            else:
                latex = f"{latex}{joints[joint.text]} {more.latex}"
            end, marked = more.end, marked or more.marked or joint.text in COMPARISONS
        return Parsed(latex, end, marked)

    def joins(self, joint: Token, end: int) -> bool:
        """Whether a joint after ``end`` is one: no hyphen or dash, nor the word "in"."""
        if joint.text == "-":
            return (joint.start > end) == self.character(joint.end).isspace()
        return joint.text != "in" or SET.match(self.text, joint.end) is not None

    def token(self, at: int) -> Token:
        """Return the next token after blanks."""
        blank = BLANK.match(self.text, at)
        match = TOKEN.match(self.text, blank.end() if blank else at)
        return Token(match.lastgroup or "mark", match[0], *match.span()) if match else Token("end", "", at, at)

    def character(self, at: int) -> str:
        """Return the character at a place; nothing at the end of the text."""
        return self.text[at : at + 1]

    def primes(self, at: int) -> str:
        """Return the primes from a place on."""
        rest = self.text[at:]
        return rest[: len(rest) - len(rest.lstrip("'"))]


def _index_in_latex(index: str) -> str:
    """Return an index in LaTeX: a word is upright."""
    if index in GREEK:
        return rf"\{index}"
    return rf"\mathrm{{{index}}}" if len(index) > 1 and index.isalpha() else index


def _roles(latex: str) -> str:
    """Return a formula as roles, between which lines of a narrow page may be broken."""
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
        try:
            latex, end, _ = parser.formula(at)
        except (NoFormulaError, RecursionError):
            at += 1
            continue
        apart = "" if parser.character(end) in " \n.,;:)" else "\\ "
        parts += [plain(text[last:at]), _roles(latex), apart]
        at = last = end
    return "".join(parts) + plain(text[last:])

"""Proofs with one number changed, or one line gone, twice or at another place."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from dataclasses import dataclass

NUDGE = 1e-6  # relative change of a number


@dataclass(frozen=True)
class Mutation:
    """What was done to which line (from 1), in which section, and the lines that it makes."""

    what: str
    line: int
    section: str
    lines: list[str]

    def __str__(self):
        return f"line {self.line} ({self.section}): {self.what}"


def flipped(text: str) -> str:
    return text[1:] if text.startswith("-") else "-" + text


def last_digit(text: str) -> str:
    mantissa, power, exponent = text.partition("p")
    digit = next(k for k in reversed(range(len(mantissa))) if mantissa[k] in "0123456789abcdef")
    other = f"{int(mantissa[digit], 16) ^ 1:x}"
    return mantissa[:digit] + other + mantissa[digit + 1 :] + power + exponent


def nudged(text: str) -> str:
    value = float.fromhex(text)
    return (value * (1 + NUDGE) if value else NUDGE).hex()


def doubled(text: str) -> str:
    return (2 * float.fromhex(text) or 1.0).hex()


NUMBERS = {"sign": flipped, "last digit": last_digit, "1e-6": nudged, "doubled": doubled}


def places(value, path=()) -> Iterator[tuple]:
    """Yield the way to every number: hexadecimal texts and whole numbers."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from places(inner, (*path, index))
    elif (isinstance(value, int) and not isinstance(value, bool)) or (isinstance(value, str) and "0x" in value):
        yield path


def replaced(line: dict, path: tuple, new) -> dict:
    """Return a line with another value at a place."""
    line = json.loads(json.dumps(line))
    inner = line
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = new
    return line


def at(line, path):
    for key in path:
        line = line[key]
    return line


def of_line(line: dict) -> Iterator[tuple[str, dict]]:
    """Yield what is done to the numbers of a line, and the line that it makes."""
    for path in places(line):
        value, where = at(line, path), ".".join(map(str, path))
        if isinstance(value, int):
            yield from ((f"{where} {step:+d}", replaced(line, path, value + step)) for step in (1, -1))
            continue
        yield from ((f"{where} {name}", replaced(line, path, change(value))) for name, change in NUMBERS.items())
        if isinstance(path[-1], int) and path[-1] + 1 < len(at(line, path[:-1])):
            following = (*path[:-1], path[-1] + 1)
            after = at(line, following)
            if after != value and not isinstance(after, list | dict):
                yield f"{where} swapped", replaced(replaced(line, path, after), following, value)


def added(line: dict, states: int) -> Iterator[tuple[str, dict]]:
    """Yield a stage of a dual with one field more, of either sign."""
    for sign in ("", "-") if "z" in line else ():
        values = [f"{sign}0x1p-2"] * states
        fields = {"mu": values, "eta": values, "image": {"": values}}
        fields |= {f"vertex {i}": {f"{i}": values} for i in (0, 1)} | {
            f"region {k}": {"": values[:1] * k} for k in (1, 2)
        }
        for name, value in fields.items():
            if name.split()[0] not in line:
                yield f"{name} {sign}added", line | {name.split()[0]: value}


def sections(lines: list[str]) -> list[str]:
    """Return the section of each line."""
    found, now = [], "first"
    for line in lines:
        now = json.loads(line).get("section", now)
        found.append(now)
    return found


def of_index(lines: list[str], index: int) -> list[Mutation]:
    """Return every mutation of one line."""
    line, section = lines[index], sections(lines)[index]
    states = max(len(json.loads(one).get("states", ())) for one in lines[:3])
    changed = [*of_line(json.loads(line)), *added(json.loads(line), states)]
    made = [("dropped", []), ("twice", [line, line]), *((what, [text(new)]) for what, new in changed)]
    found = [Mutation(what, index + 1, section, [*lines[:index], *new, *lines[index + 1 :]]) for what, new in made]
    if index + 1 < len(lines):
        exchanged = [*lines[:index], lines[index + 1], line, *lines[index + 2 :]]
        found.append(Mutation("after the next", index + 1, section, exchanged))
    return found


def text(line: dict) -> str:
    """Return an object as a line."""
    return json.dumps(line) + "\n"


def mutations(lines: list[str]) -> Iterator[Mutation]:
    """Yield every mutation of a proof's lines, in their order."""
    for index in range(len(lines)):
        yield from of_index(lines, index)


def sample(lines: list[str], size: int, seed: int) -> list[Mutation]:
    """Return some mutations of each section; the same ones for the same seed."""
    chosen, groups = random.Random(seed), {}
    for index, section in enumerate(sections(lines)):
        groups.setdefault(section, []).append(index)
    return [chosen.choice(of_index(lines, chosen.choice(group))) for group in groups.values() for _ in range(size)]

"""Tables that do not fit a narrow terminal: fewer columns, or several tables, and lines broken between words only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Column, Table
from rich.text import Text

LONGEST_WORD = 16  # longer words may be broken: names of files, for instance
ROOMY = 60  # columns from which on a term stands beside its text, and not above it
FIRST = 16  # least width of the first column, which says what a row is, where a table is shown in several
BETWEEN, INDENT = 1, 2  # blank columns between the columns of a narrow table, and before a text below its term


@dataclass(frozen=True)
class _Width:
    """Width of a column without any line break, and its least: the longest word, or all of a number."""

    least: int
    natural: int


def fitted(table: Table, width: int, spare: Sequence[str] = ()) -> RenderableType:
    """Return a table of texts in at most ``width`` columns; columns justified to the right are not wrapped.

    Columns with the ``spare`` headings are left out, the first one first. If that is not enough, the others are shown
    in several tables, each with the first column.
    """
    widths = [_width(column) for column in table.columns]
    if sum(column.natural for column in widths) + 3 * len(widths) + 1 <= width:
        return table
    shown, left_out = list(range(len(widths))), list[str]()
    headings = [_plain(column.header) for column in table.columns]
    for heading in spare:
        if _least(widths, shown) <= width:
            break
        shown.remove(headings.index(heading))
        left_out.append(heading)
    if _least(widths, shown) > width:
        widths[0] = _Width(max(widths[0].least, min(widths[0].natural, FIRST)), widths[0].natural)
    parts = [_part(table, columns, widths, width) for columns in _chunks(widths, shown, width)]
    for part in parts[1:]:
        part.title = None
    for part in parts[:-1]:
        part.caption = None
    if left_out:
        parts[-1].caption = Text(f"No room for: {', '.join(left_out)}.")
    return Group(*parts)


def terms(rows: Sequence[tuple[str, str]], width: int) -> RenderableType:
    """Return terms with their texts beside them, or below them where there is not the room."""
    if width >= ROOMY:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column()
        for term, text in rows:
            grid.add_row(Text(term, style="bold"), Text(text))
        return grid
    lines = list[RenderableType]()
    for term, text in rows:
        lines.append(Text(term, style="bold"))
        lines += [Padding(Text(text), (0, 0, 0, INDENT))] if text else []
    return Group(*lines)


def _plain(cell: RenderableType) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _width(column: Column) -> _Width:
    """Return how wide a column is; a heading may be broken between words in any column."""
    cells, heading = [_plain(cell) for cell in column.cells], _plain(column.header)
    natural = max((cell_len(cell) for cell in [heading, *cells]), default=0)
    words = [len(text) - len(text.lstrip()) + cell_len(word) for text in [heading, *cells] for word in text.split()]
    least = min(max(words, default=0), LONGEST_WORD)
    if column.justify == "right":
        least = max([least, *(cell_len(cell) for cell in cells)])
    return _Width(least, natural)


def _least(widths: Sequence[_Width], columns: Sequence[int]) -> int:
    return sum(widths[i].least for i in columns) + BETWEEN * (len(columns) - 1)


def _chunks(widths: Sequence[_Width], columns: Sequence[int], width: int) -> list[list[int]]:
    """Return the columns of each table: the first, and as many of the others as there is room for, at least one."""
    first, *others = columns
    chunks = [[first]]
    for i in others:
        if len(chunks[-1]) > 1 and _least(widths, [*chunks[-1], i]) > width:
            chunks.append([first])
        chunks[-1].append(i)
    return chunks


def _part(table: Table, columns: Sequence[int], widths: Sequence[_Width], width: int) -> Table:
    """Return some columns of a table, without lines between them, each as wide as it can be."""
    part = Table(title=table.title, caption=table.caption, box=box.SIMPLE_HEAD, padding=0)
    part.pad_edge, part.show_edge, part.collapse_padding = False, False, False
    room = max(width - _least(widths, columns), 0)
    wanted = sum(widths[i].natural - widths[i].least for i in columns)
    for i in columns:
        column, more = table.columns[i], widths[i].natural - widths[i].least
        share = min(more, room * more // wanted) if wanted else 0
        part.add_column(
            column.header,
            justify=column.justify,
            style=column.style,
            overflow="fold",
            width=min(widths[i].least + share, width),
        )
    cells = [list(table.columns[i].cells) for i in columns]
    for row, here in zip(table.rows, zip(*cells, strict=True), strict=True):
        part.add_row(*here, style=row.style, end_section=row.end_section)
    return part

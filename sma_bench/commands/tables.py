"""Tables that fit: as wide as they need be in a file, no wider than a terminal.

What does not fit is folded, never cut, since a name that is cut cannot be looked up; where folding
does not do either, every row becomes a block of lines.
"""

from collections.abc import Container, Sequence
from os import environ

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from sma_bench.border import printable

_NARROWEST, _NARROWEST_NAME = 20, 30  # cells of a column that is folded; of the first one
_NEVER_BROKEN = 10
_BETWEEN = 2
_FOR_FILES = 10_000
_SAYS_NOTHING = ("", "·")


def output_console() -> Console:
    """Standard output; in a file or a pipe lines are as long as they are."""
    console = Console(highlight=False)
    if not console.is_terminal and "COLUMNS" not in environ:
        console.width = _FOR_FILES
    return console


def print_table(
    console: Console,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Container[int] = (),
    *,
    title: str = "",
    styles: Sequence[str] = (),
) -> None:
    """Print a table.

    Args:
        headings, rows: text, not markup, a cell a column.
        right: columns of numbers, flush right and never folded.
        styles: of the rows, none when empty.
    """
    rows = [[printable(cell, "\n") for cell in row] for row in rows]
    columns = list(zip(headings, *rows, strict=True))
    widths = _widths(columns, right, console.width - _BETWEEN * (len(columns) - 1))
    if not widths:
        _print_blocks(console, headings, rows, title, styles)
        return
    if title:
        console.print(f"[bold]{escape(title)}[/]")
    table = Table(box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        if k in right:
            table.add_column(Text(heading), justify="right", no_wrap=True, width=widths[k])
        else:
            table.add_column(Text(heading), overflow="fold", width=widths[k])
    for k, row in enumerate(rows):
        table.add_row(*map(Text, row), style=styles[k] if styles else None)
    console.print(table)


def _widths(columns: Sequence[Sequence[str]], right: Container[int], space: int) -> list[int]:
    """Widths of the columns: text wrapped between words, or else within them, as little as may be
    in the first column, by which one looks things up; none where that needs more space."""
    lines = [[line for cell in column for line in cell.split("\n")] for column in columns]
    full = [max(map(cell_len, own)) for own in lines]
    whole, least = [], []
    for k, own in enumerate(lines):
        if k in right or full[k] <= _NEVER_BROKEN:
            word = shortest = full[k]
        else:
            word = max((cell_len(word) for line in own for word in line.split()), default=0)
            shortest = min(full[k], _NARROWEST) if full[k] > _NARROWEST else word
        whole.append(max(word, shortest))
        least.append(shortest)
    widths = whole
    if sum(whole) > space:
        widths = [min(whole[0], space - sum(least[1:])), *least[1:]]
    if widths[0] < min(whole[0], _NARROWEST_NAME):
        return []
    for k, wanted in enumerate(full):
        widths[k] += min(wanted - widths[k], space - sum(widths))
    return widths


def _print_blocks(
    console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]], title: str,
    styles: Sequence[str],
) -> None:
    """The first cell of a row on a line of its own, below it the others with their headings."""
    if title:
        console.print(f"[bold]{escape(title)}[/]")
    for k, (name, *cells) in enumerate(rows):
        style = styles[k] if styles else ""
        console.print(Text(name, style=style or "bold", overflow="fold"))
        for heading, cell in zip(headings[1:], cells, strict=True):
            if cell not in _SAYS_NOTHING:
                line = f"  {heading}: {cell}" if heading else f"  {cell}"
                console.print(Text(line, style=style, overflow="fold"))

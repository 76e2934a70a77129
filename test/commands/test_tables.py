"""Tables fit the terminal: folded, never cut, names last."""

import io

import pytest
from rich.cells import cell_len
from rich.console import Console

from sma_bench.cli import main
from sma_bench.commands.terminal import print_table
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS

HEADINGS = ("name", "value", "remark")
ROWS = [
    ("effect.side_heat_coupling.conductance", "0.00123", "heat from the other side"),
    ("試験片の抵抗", "2.6987", "[bold] is no markup"),
]


def printed(width, rows=ROWS, right=(1,)):
    out = io.StringIO()
    console = Console(file=out, width=width, force_terminal=True, color_system=None)
    print_table(console, HEADINGS, rows, right)
    return out.getvalue()


@pytest.mark.parametrize("right", [(), (1,)])
@pytest.mark.parametrize("rows", [ROWS, [(e.name, e.stage, e.shows) for e in EFFECTS.values()]])
def test_nothing_is_wider_than_the_terminal_and_nothing_is_lost(rows, right):
    given = sorted("".join("".join("".join(cells).split()) for cells in (HEADINGS, *rows)))
    for width in range(30, 200, 7):
        text = printed(width, rows, right)
        assert max(cell_len(line) for line in text.splitlines()) <= width
        assert sorted("".join(text.split())) == given, width
    head, first, second = printed(80).splitlines()  # numbers are flush right
    ends = [
        cell_len(line[: line.index(word)] + word)
        for line, word in ((head, "value"), (first, "0.00123"), (second, "2.6987"))
    ]
    assert len(set(ends)) == 1 and "[bold] is no markup" in second


@pytest.mark.parametrize("columns", ["80", "60", "40"])
@pytest.mark.parametrize("words", [["effects"], ["parameters"], ["audit"]])
def test_what_commands_print_fits_and_names_can_be_looked_up(words, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    assert main(words) == 0
    out = capsys.readouterr().out
    assert max(cell_len(line.rstrip()) for line in out.splitlines()) <= int(columns)
    names = {"effects": EFFECTS, "parameters": BY_NAME}.get(words[0], {})
    if columns == "80":
        assert [name for name in names if len(name) <= 36 and name not in out] == []

"""Tables fit the terminal: folded, never cut, names last."""

import pytest
from rich.cells import cell_len

from sma_bench.cli import main
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS


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

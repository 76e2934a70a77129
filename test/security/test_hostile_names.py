"""Names of bags and results with markup, escapes or invalid text are shown without any effect."""

import os

import numpy as np

from sma_bench.cli import main
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.report.page import Picture


def test_names_do_nothing_to_a_terminal_a_yaml_file_or_a_report(tmp_path, capsys, monkeypatch):
    """Escapes, control characters and invalid text in names of folders and in markers."""
    time = np.arange(200) * 0.1
    voltage = Signal("wire.voltage", "V", time, np.ones(200))
    marker = "\x1b]0;owned\x07\x1b[2J heat\r\nnext"
    for name in ("a\x1b[31mb\x07", os.fsdecode(b"caf\xe9"), "line\nbreak", "back\x85\u2028"):
        bag, out = str(tmp_path / name), tmp_path / f"report of {name}"
        write_record(tmp_path / name, [voltage], markers=[(0.0, marker)])
        for command in (
            ["info", bag], ["report", bag, "--out", str(out)],
            ["report", f"{bag}.json", "--out", str(out)], ["identify", bag, "--out", f"{bag}.yaml"],
            ["diagnose", bag],
        ):  # fmt: skip
            assert main(command) in (0, 2)
            told = capsys.readouterr()
            for line in (told.out + told.err).split("\n"):
                assert line.isprintable(), (command[0], name, line)
        text = (out / "index.html").read_text(encoding="utf-8")
        assert "\x1b" not in text and "\x07" not in text
        monkeypatch.setattr(Picture, "_file", lambda *_, **__: b"")  # those of one name are drawn

    # The parameter file is readable, whatever its comment contains.
    names = "bag\x1b\x07\x00 \udcff \u2028 \x85 \ufffe\r"
    write_parameters(tmp_path / "p.yaml", Parameters({"wire.mass": 1e-4}), f"from {names}")
    assert read_parameters(tmp_path / "p.yaml")["wire.mass"] == 1e-4

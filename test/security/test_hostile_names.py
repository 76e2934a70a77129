"""A report of a bag whose folder and file names are markup shows them, and runs nothing."""

import html
import os

import numpy as np

from sma_bench.cli import main
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record

HOSTILE = "<img src=x onerror=alert(1)>&{{7*7}}"


def test_names_of_bags_and_results_are_escaped_in_the_report(tmp_path, pytestconfig):
    bag, result = tmp_path / HOSTILE, tmp_path / f"{HOSTILE}.json"
    rig = pytestconfig.rootpath / "config" / "wire_rig.yaml"
    assert main([
        "simulate", "--protocol", "quick_staircase", "--params", str(rig), "--rate", "20",
        "--noise", "1", "--out", str(bag),
    ]) == 0  # fmt: skip
    assert main(["identify", str(bag), "--json", str(result)]) == 0
    for given, out in ((bag, tmp_path / "of_bag"), (result, tmp_path / "of_result")):
        assert main(["report", str(given), "--out", str(out)]) == 0
        (page,) = out.glob("*.html")
        text = page.read_text()
        assert "<img src=x" not in text
        if given == bag:
            assert html.escape(HOSTILE) in text or html.escape(HOSTILE, quote=False) in text


def test_names_do_nothing_to_a_terminal_a_yaml_file_or_a_report(tmp_path, capsys):
    """Escapes and controls, bytes that are no text, in the names of folders and in markers."""
    time = np.arange(200) * 0.1
    voltage = Signal("wire.voltage", "V", time, np.ones(200))
    marker = "\x1b]0;owned\x07\x1b[2J heat\r\nnext"
    for name in ("a\x1b[31mb\x07", os.fsdecode(b"caf\xe9"), "line\nbreak", "back\x85\u2028"):
        bag, out = tmp_path / name, tmp_path / f"report of {name}"
        write_record(bag, [voltage], markers=[(0.0, marker)])
        for command in (
            ["info", str(bag)],
            ["report", str(bag), "--out", str(out)],
            ["report", str(bag) + ".json", "--out", str(out)],
            ["identify", str(bag), "--out", str(tmp_path / f"{name}.yaml")],
            ["diagnose", str(bag)],
        ):
            assert main(command) in (0, 2)
            told = capsys.readouterr()
            for line in (told.out + told.err).split("\n"):
                assert line.isprintable(), (command[0], name, line)
        assert (out / "index.html").is_file()
        text = (out / "index.html").read_text(encoding="utf-8")
        assert "\x1b" not in text and "\x07" not in text

    # A parameter file can be read whatever its comment.
    names = "bag\x1b\x07\x00 \udcff \u2028 \x85 \ufffe\r"
    write_parameters(tmp_path / "p.yaml", Parameters({"wire.mass": 1e-4}), f"from {names}")
    assert read_parameters(tmp_path / "p.yaml")["wire.mass"] == 1e-4

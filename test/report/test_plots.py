"""`plot()`: figures for pages, notebooks and papers, and overlaid records."""

import csv
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import sma_bench
from sma_bench import border
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.records.bag_writer import write_record
from sma_bench.report.drawing import COLUMNS, named_rows
from sma_bench.report.page import Picture, Section, Table, write_report

WIRES = ["front_1", "front_2", "back_1", "back_2"]
TIME = np.arange(0.0, 20.0, 0.05)


@pytest.fixture(scope="module")
def record():
    """Four wires, driven one after the other; their temperatures follow."""
    columns = {"time": TIME, "deflection": 1e-3 * np.sin(TIME)}
    for k, wire in enumerate(WIRES):
        volts = np.where((2.0 + 4.0 * k < TIME) & (4.0 + 4.0 * k > TIME), 3.0 + k, 0.0)
        columns |= {f"{wire}.voltage": volts, f"{wire}.temperature": 296.0 + 5.0 * volts}
    return sma_bench.load(columns)


def labels_of(axes):
    return [line.get_label() for line in axes.lines]


def rows_of(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_record_draws_what_is_asked_for(record):
    panels = record.plot().figure.axes
    labels = [panel.get_ylabel() for panel in panels]
    assert labels == ["voltage\n[V]", "temperature\n[K]", "deflection\n[mm]"]
    assert labels_of(panels[0]) == WIRES
    assert len({str(line.get_linestyle()) for line in panels[0].lines}) == 4
    (one,) = record.plot("back_1.voltage").figure.axes
    assert labels_of(one) == ["back_1"]
    with pytest.raises(InputError, match=r"plot: no current to draw: it has deflection"):
        record.plot("current")


def test_a_figure_is_saved_for_a_paper_and_as_plain_numbers(record, tmp_path):
    plot = record.plot("temperature")
    for name in ("a.png", "a.svg", "a.pdf", "a.csv"):
        plot.save(tmp_path / name)
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert "front_1</text>" in (tmp_path / "a.svg").read_text()  # text stays text
    rows = [row for row in rows_of(tmp_path / "a.csv") if row["curve"] == "back_2"]
    assert max(float(row["y"]) for row in rows) == pytest.approx(326.0)
    assert {row["panel"] for row in rows} == {"temperature [K]"}
    with pytest.raises(InputError, match="expected a name that ends in"):
        plot.save(tmp_path / "a.jpg")


def test_a_curve_is_written_with_the_names_of_its_own_axes_and_rows(tmp_path):
    figure = Figure()
    left, right = figure.subplots(1, 2, sharey=True)
    picture = Picture("p", "title", "caption", figure)
    right.set_xlabel("informed [%]")
    with pytest.raises(InputError, match=r"p has no curves, expected \.png, \.svg or \.pdf"):
        picture.save(tmp_path / "a.csv")
    left.set_xlabel("off [%]")
    left.plot([5.0, 6.0], named_rows(left, ["ohm", "kelvin"]), "o")
    picture.save(tmp_path / "a.csv")
    assert [list(row.values())[2:] for row in rows_of(tmp_path / "a.csv")] == [
        ["off [%]", "5", "ohm"], ["off [%]", "6", "kelvin"]]


def test_a_column_has_its_width_and_letters_and_leaves_the_figure_as_it_was(record):
    plot = record.plot("temperature")
    before = plot.figure.get_size_inches().tolist()
    column = COLUMNS["single"]._replace(font=6.0)
    svg = plot.files(column)["signals.svg"].decode()
    assert float(re.search(r'width="([\d.]+)pt"', svg)[1]) == pytest.approx(89.0 / 25.4 * 72.0)
    sizes = {float(size) for size in re.findall(r"font(?:-size)?: ?([\d.]+)px", svg)}
    assert min(sizes) >= 5.0 and max(sizes) <= 7.2 + 1e-6
    assert plot.figure.get_size_inches().tolist() == before


def test_a_report_replaces_a_report_whole_and_nothing_else(tmp_path, monkeypatch):
    figure = Figure()
    figure.subplots().plot([0, 1], [1, 0])
    sections = [Section("Result", pictures=[Picture("fig", "A line", "from nothing", figure)])]
    folder = tmp_path / "r"
    folder.mkdir()
    (folder / "index.html").write_text("<p>my page</p>")
    with pytest.raises(InputError, match="index.html, which is not part of a report"):
        write_report(folder, "T", "s", sections)
    assert [p.name for p in folder.iterdir()] == ["index.html"]
    (folder / "index.html").unlink()
    (folder / "notes.txt").write_text("mine")
    monkeypatch.setattr(border, "_STILL_HELD", 0.0)

    def meanwhile(*_):
        with pytest.raises(InputError, match="is being written as a report already: process"):
            write_report(folder / ".." / "r", "two", "s", sections)

    write_report(folder, "one", "s", sections, report=meanwhile)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}

    def fail(source, target):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match="cannot write the report: Input/output error"):
        write_report(folder, "two", "s", sections)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    monkeypatch.undo()
    write_report(folder, "two", "s", sections)
    assert "<title>two</title>" in (folder / "index.html").read_text()
    assert (folder / "notes.txt").read_text() == "mine"


def test_tables_become_csv_and_names_from_outside_are_text(tmp_path):
    rows = [["current", "20.5 mA", "82 to 100 %"], ["deflection", "0.1 mm", ""]]
    hostile = "=HYPERLINK(1)\x1b[2J\udcff\u202e"
    tables = [Table(["q", "rms", "90 %"], rows, frozenset({1, 2}), "t"),
              Table(["name"], [[hostile], ["-1.5"]], name="names")]  # fmt: skip
    sections = [Section("S", [hostile], tables=tables)]
    page = write_report(tmp_path / "r", hostile, "s", sections, column=COLUMNS["double"])
    written = [list(row) for row in csv.reader((tmp_path / "r" / "t.csv").open())]
    assert written == [["q", "rms", "90 %"], *rows]
    text = page.read_text(encoding="utf-8")
    assert "=HYPERLINK(1)\\x1b[2J\\udcff\\u202e" in text and "\x1b" not in text
    names = (tmp_path / "r" / "names.csv").read_text().splitlines()
    assert names == ["name", "'=HYPERLINK(1)\\x1b[2J\\udcff\\u202e", "-1.5"]


# --- Overlaid records.


def later(record, seconds):
    signals = {n: replace(s, time=s.time + seconds) for n, s in record.signals.items()}
    return replace(record, signals=signals)


def test_clocks_are_aligned_by_the_drive_and_the_worst_difference_is_found(record):
    values = record["deflection"].values.copy()
    values[100] += 5e-4  # at 5 s
    other = later(record, 1.73)
    other.signals["deflection"] = replace(other["deflection"], values=values)
    found = sma_bench.compare({"monday": record, "tuesday": other})
    assert found.shifts["tuesday"] == pytest.approx(-1.73, abs=0.01)
    worst = found.differences[0]
    assert (worst.signal, worst.record) == ("deflection", "tuesday")
    assert worst.worst == pytest.approx(5e-4, rel=0.05) and worst.at == pytest.approx(5.0, abs=0.06)
    assert "+0.5 mm" in str(found) and found.remarks == ()
    upper, lower = found.plot("deflection").figure.axes
    assert labels_of(upper) == ["monday", "tuesday"] and lower.get_ylabel() == "difference [mm]"


@pytest.mark.usefixtures("undrawn")
def test_records_and_models_are_compared_by_the_command(tmp_path, capsys):
    run = sma_bench.simulate("quick_staircase", effects={"supply_drop": 0.2}, rate=10.0)
    write_record(tmp_path / "monday", sma_bench.load(run).signals.values())
    lab = tmp_path / "lab.yaml"
    lab.write_text("/**:\n  ros__parameters:\n    wire:\n      resistance: 2.7\n")
    words = ["compare", str(tmp_path / "monday"), "--model", str(lab), "--column", "single"]
    answer = tmp_path / "d.json"
    assert main([*words, "--json", str(answer), "--out", str(tmp_path / "page")]) == 0
    first = json.loads(answer.read_text())["differences"][0]
    shown = capsys.readouterr().out
    assert first["record"] == "lab.yaml" and first["rms"] > 0.0
    assert shown.splitlines()[1].split()[:2] == [first["signal"], "lab.yaml"]
    names = {path.name for path in (tmp_path / "page").iterdir()}
    assert {"overlay.pdf", "overlay.svg", "overlay.csv", "differences.csv"} <= names
    assert "lab.yaml" in (tmp_path / "page" / "index.html").read_text()

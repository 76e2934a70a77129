"""`sma-bench report`: one page of records and result files, whole or not at all."""

import base64
import csv
import hashlib
import json
import xml.etree.ElementTree as Xml
from html.parser import HTMLParser

import numpy as np
import pytest

from sma_bench.cli import main
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.report.drawing import script, thinned
from sma_bench.report.page import digest

EVIL = "<script>alert(1)</script> & $\\frac{$"
IDENTIFIED = {
    "parameters": {
        "wire.resistance": {
            "value": 2.75, "std": 0.01, "unit": "ohm", "method": EVIL, "n": 50,
        },
        "own.number": {"value": 1.0, "std": None, "unit": EVIL, "method": "", "n": 0},
    },
    "experiments": [
        {
            "name": "E1", "title": "resistance", "source": EVIL,
            "estimates": {"wire.resistance": {"value": 2.75, "std": 0.01, "unit": "ohm"}},
            "details": {}, "findings": [],
        }
    ],
    "warnings": ["E1 plateau: not settled"],
}  # fmt: skip
DIAGNOSED = {
    "verdict": "effect", "cause": ["side_heat_coupling"],
    "candidates": [
        {
            "name": "side_heat_coupling", "stage": "thermal", "probability": 0.93,
            "gap_over_noise": 2.5, "log_evidence": 41.0,
            "parameters": {
                "effect.side_heat_coupling.conductance":
                    {"value": 2e-3, "std": 1e-4, "unit": "W/K"},
            },
        },
        {"name": "recalibration", "stage": "", "probability": 0.07, "gap_over_noise": 1.0,
         "log_evidence": 0.0, "parameters": {}},
    ],
    "where": {
        "signal": "deflection", "phase": "rest", "side": "back", "stage": "thermal",
        "table": [{"signal": "deflection", "phase": "rest", "side": "back", "gap": 2.5,
                   "share": 0.6, "rms": 1.2e-3}],
        "chain": [{"block": "V -> deflection", "gap": 2.0, "ci90": [1.5, 2.5], "rms": 1e-3}],
    },
    "shrinkage": {
        "deflection": {"rmse_before": 1.2e-3, "rmse_after": 2e-4, "fraction": 0.9,
                       "ci90": [0.8, 0.95], "noise_floor": 1e-4},
    },
    "next_experiment": {"why": "drive the front " + EVIL, "separates": [], "protocol": {}},
    "findings": ["info: nothing", "warning: wire.mass: odd"],
}  # fmt: skip


class Page(HTMLParser):
    """Tags with their attributes, and the text between them."""

    def __init__(self, path):
        super().__init__()
        self.path, self.tags, self.texts = path, [], []
        self.feed(path.read_text())
        self.text = " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture
def bag(tmp_path):
    time = np.arange(0.0, 20.0, 0.01)
    levels = {"voltage": ("V", 2.0), "current": ("A", 0.7), "temperature": ("K", 320.0)}
    signals = [
        Signal(f"wire.{name}", unit, time, value * (1.0 + 0.1 * np.sin(time)))
        for name, (unit, value) in levels.items()
    ]
    path = tmp_path / "bag"
    write_record(path, signals, markers=[(1.0, EVIL)])
    return path


@pytest.fixture
def results(tmp_path):
    paths = []
    for name, document in (("identified", IDENTIFIED), ("diagnosis", DIAGNOSED)):
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(document))
        paths.append(path)
    return paths


def report(tmp_path, *words):
    out = tmp_path / "out"
    assert main(["report", *map(str, words), "--out", str(out)]) == 0
    return out


def test_a_page_of_everything_stands_alone_and_is_escaped(tmp_path, bag, results, capsys):
    params = tmp_path / "lab.yaml"
    params.write_text("/**:\n  ros__parameters:\n    wire:\n      resistance: 2.8\n")
    out = report(tmp_path, bag, *results, "--params", params, "--title", EVIL)
    page = Page(out / "index.html")
    # The curves as data, and the one script that the page's own policy lets run.
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert scripts == [{"type": "application/json"}, {}]
    assert page.path.read_text().count("<script>") == 1
    assert f"<script>{script()}</script>" in page.path.read_text()
    (said,) = [a["content"] for _, a in page.tags if a.get("http-equiv")]
    allowed = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()
    assert "default-src 'none'" in said and f"script-src 'sha256-{allowed}'" in said
    for tag, attributes in page.tags:
        assert not attributes.get("src", "data:").startswith(("http", "/"))
        assert tag not in ("link", "iframe") and "href" not in attributes
    assert " ".join(EVIL.split()) in page.text
    pictures = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 4
    assert all(src.startswith("data:image/png;base64,iVBOR") for src in pictures)
    for said in ("Summary", "Provenance", "2.75 ± 0.01 ohm", "side_heat_coupling", "1.2 mm",
                 "0.002 ± 0.0001 W/K", "2.8", "80 to 95 %"):  # fmt: skip
        assert said in page.text, said


def test_warnings_of_all_inputs_come_first(tmp_path, bag, results, capsys):
    text = Page(report(tmp_path, *results) / "index.html").text
    summary = text[: text.index("Identification ")]
    assert "E1 plateau: not settled" in summary and "wire.mass: odd" in summary
    assert "info: nothing" not in summary and "2 warnings" in summary
    assert "warnings 2" in capsys.readouterr().out


def test_provenance_names_hashes_versions_and_the_command(tmp_path, bag, results, capsys):
    target = tmp_path / "report.json"
    out = report(tmp_path, bag, results[0], "--json", target)
    found = json.loads(target.read_text())
    assert found["inputs"][1]["sha256"] == hashlib.sha256(results[0].read_bytes()).hexdigest()
    assert found["inputs"][0]["kind"] == "bag"
    assert found["command"].startswith("sma-bench report ") and str(bag) in found["command"]
    assert {"sma_bench", "Python", "numpy"} <= set(found["versions"])
    text = Page(out / "index.html").text
    for one in found["inputs"]:
        assert one["sha256"] in text
    assert found["versions"]["numpy"] in text and found["command"] in text


def test_no_number_is_told_twice(tmp_path, results, capsys):
    found = json.loads(results[0].read_text())
    found["experiments"][0]["details"] = {"slope": {"value": 2.7, "std": 0.1, "unit": "ohm"}}
    results[0].write_text(json.dumps(found))
    out = report(tmp_path, results[0])
    assert (out / "input_1_experiment_1.csv").read_text().count("\n") == 2  # heading and slope
    assert (out / "input_1_parameters.csv").read_text().count("\n") == 3


def test_a_bags_hash_follows_its_contents_and_names(bag, tmp_path):
    before, size = digest(bag)
    assert size == sum(path.stat().st_size for path in bag.iterdir())
    assert digest(bag) == (before, size)
    storage = next(bag.glob("*.mcap"))
    content = bytearray(storage.read_bytes())
    content[100] ^= 1
    storage.write_bytes(content)
    assert digest(bag)[0] != before
    content[100] ^= 1
    storage.write_bytes(content)
    assert digest(bag)[0] == before
    storage.rename(bag / "other.mcap")
    assert digest(bag)[0] != before


def test_figures_and_tables_are_there_for_papers(tmp_path, bag, results, capsys):
    out = report(tmp_path, bag, *results)
    pictures = {path.stem for path in out.glob("*.png")}
    assert len(pictures) == 4 and pictures == {path.stem for path in out.glob("*.svg")}
    for path in out.glob("*.svg"):
        assert Xml.parse(path).getroot().tag.endswith("svg")
    with (out / "input_2_parameters.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows[0]["value"] == "2.75" and rows[0]["unit"] == "ohm" and rows[0]["method"] == EVIL
    with (out / "input_1_signals_over_time.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["panel"] == "temperature [K]"]
    assert {row["curve"] for row in rows} == {"wire"}
    assert max(float(row["y"]) for row in rows) == pytest.approx(352.0, abs=0.01)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.json", "{", "not JSON"), ("a.json", "[1]", "not a result"),
        ("a.json", b"\xff\xfe", "not a text file"), ("a.txt", "hello", "neither a bag"),
        ("none.json", None, "cannot read"),
        ("a.json", json.dumps(IDENTIFIED | {"parameters": []}), "damaged result"),
        ("a.json", json.dumps(DIAGNOSED | {"verdict": 3}), "verdict"),
    ],
)
def test_what_is_no_result_is_one_line_and_nothing_is_written(
    name, content, said, tmp_path, bag, capsys
):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["report", str(bag), str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error and str(path) in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_instrument_files_are_drawn(measured_data, tmp_path, capsys):
    folder = measured_data / "sma_react" / "input"
    pulled = tmp_path / "tensile.csv"
    strain = np.linspace(0.0, 0.05, 60)
    pulled.write_text("".join(["Strain,Stress (MPa)\n", *(f"{e:.5f},{4e4 * e}\n" for e in strain)]))
    records = [folder / "preprocessor_samples" / "DSC.txt", folder / "cal_sample_1" / "50 MPa.txt",
               pulled]  # fmt: skip
    page = Page(report(tmp_path, *records) / "index.html")
    assert len([tag for tag, _ in page.tags if tag == "img"]) == 3
    assert "tensile test" in page.text and "isobaric test at 50" in page.text


def test_thinning_keeps_every_peak():
    time = np.arange(100_000.0)
    values = np.zeros_like(time)
    values[[17, 54_321]] = (3.0, -2.0)
    t, v = thinned(time, values, 3000)
    assert len(t) <= 3000 and v.max() == 3.0 and v.min() == -2.0
    assert (np.diff(t) > 0.0).all()

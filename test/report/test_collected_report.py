"""`sma-bench report`: one page of records and result files, written as a whole or not at all."""

import base64
import copy
import hashlib
import html
import json
import re
import xml.etree.ElementTree as Xml

import numpy as np
import pytest
from test_cards import DIAGNOSED, IDENTIFIED
from test_plots import rows_of

from sma_bench.cli import main
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.report.drawing import script
from sma_bench.report.page import digest

EVIL = "<script>alert(1)</script> & $\\frac{$"
PICTURES = {"input_1_signals_over_time", "input_2_agreement"}


def text_of(page):
    """The visible text of a page."""
    body = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.S)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", body)).split())


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A bag, results of both kinds with hostile names, and a parameter file."""
    folder = tmp_path_factory.mktemp("lab")
    time = np.arange(0.0, 20.0, 0.01)
    levels = {"voltage": ("V", 2.0), "current": ("A", 0.7), "temperature": ("K", 320.0)}
    signals = [Signal(f"wire.{name}", unit, time, value * (1.0 + 0.1 * np.sin(time)))
               for name, (unit, value) in levels.items()]  # fmt: skip
    write_record(folder / "bag", signals, markers=[(1.0, EVIL)])
    found, gap = copy.deepcopy(IDENTIFIED), copy.deepcopy(DIAGNOSED)
    found["parameters"]["wire.resistance"]["method"] = found["experiments"][0]["source"] = EVIL
    found["experiments"][0]["details"] = {"slope": {"value": 2.7, "std": 0.1, "unit": "ohm"}}
    gap["next_experiment"] = {"why": "drive " + EVIL, "separates": [], "protocol": {}}
    gap["findings"] = ["info: nothing", *gap["findings"]]
    (folder / "identified.json").write_text(json.dumps(found))
    (folder / "diagnosis.json").write_text(json.dumps(gap))
    (folder / "lab.yaml").write_text("/**:\n  ros__parameters: {wire: {resistance: 2.8}}\n")
    return folder


@pytest.fixture(scope="module")
def out(lab):
    """The report of all these inputs."""
    inputs = [str(lab / name) for name in ("bag", "identified.json", "diagnosis.json")]
    words = ["--params", str(lab / "lab.yaml"), "--title", EVIL, "--out", str(lab / "out")]
    assert main(["report", *inputs, *words, "--json", str(lab / "report.json")]) == 0
    return lab / "out"


def test_a_collected_page_is_self_contained_escaped_and_has_its_provenance(lab, out):
    raw = (out / "index.html").read_text()
    text = text_of(raw)
    # The curves as data, and the only script that the page's policy allows.
    assert EVIL not in raw and "<script>alert" not in raw
    assert re.findall(r"<script[^>]*>", raw) == ['<script type="application/json">', "<script>"]
    assert f"<script>{script()}</script>" in raw
    allowed = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()
    (said,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', raw)
    assert "default-src 'none'" in said and f"script-src 'sha256-{allowed}'" in said
    assert not re.search(r'(?:src|href)="(?!data:)|<(?:link|iframe)', raw)
    assert raw.count('src="data:image/png;base64,iVBOR') == len(PICTURES)
    for said in (" ".join(EVIL.split()), "2.800 ± 0.0070 ± 0.024 ohm", "supply_drop", "50 mA",
                 "0.3012 ± 0.0021 ohm", "95 to 99 %", "Provenance", "lab.yaml", "resistance"):
        assert said in text, said
    # Warnings of all inputs come first.
    summary = text[text.index("Summary") : text.index("Identification ")]
    assert "E2: not settled" in summary and "wire.mass: odd" in summary
    assert "info: nothing" not in summary and "3 warnings" in summary
    # Hashes, versions and the command.
    found = json.loads((lab / "report.json").read_text())
    sha = hashlib.sha256((lab / "identified.json").read_bytes()).hexdigest()
    assert [one["kind"] for one in found["inputs"]] == ["bag", "identification", "diagnosis"]
    assert found["inputs"][1]["sha256"] == sha
    assert found["command"].startswith("sma-bench report ") and str(lab) in found["command"]
    for said in (*(one["sha256"] for one in found["inputs"]), found["versions"]["numpy"]):
        assert said in text


def test_a_bags_hash_follows_its_contents_and_names(tmp_path):
    bag = tmp_path / "bag"
    write_record(bag, [Signal("wire.voltage", "V", np.arange(9.0), np.arange(9.0))])
    before, size = digest(bag)
    assert size == sum(path.stat().st_size for path in bag.iterdir())
    storage = next(bag.glob("*.mcap"))
    content = bytearray(storage.read_bytes())
    for same in (False, True):
        content[100] ^= 1
        storage.write_bytes(content)
        assert (digest(bag)[0] == before) is same
    storage.rename(bag / "other.mcap")
    assert digest(bag)[0] != before


def test_figures_and_tables_are_written_for_papers_and_no_number_appears_twice(out):
    assert {path.stem for path in out.glob("*.png")} == PICTURES
    assert {path.stem for path in out.glob("*.svg")} == PICTURES
    for path in out.glob("*.svg"):
        assert Xml.parse(path).getroot().tag.endswith("svg")
    resistance, room = rows_of(out / "input_2_parameters.csv")
    assert (resistance["unit"], resistance["method"]) == ("ohm", EVIL)
    assert float(resistance["value"]) == 2.8 and room["unit"] == "K"
    own = rows_of(out / "input_2_experiment_1.csv")
    assert [row["parameter"] for row in own] == ["slope"]
    rows = rows_of(out / "input_1_signals_over_time.csv")
    rows = [row for row in rows if row["panel"] == "temperature [K]"]
    assert {row["curve"] for row in rows} == {"wire"}
    assert max(float(row["y"]) for row in rows) == pytest.approx(352.0, abs=0.01)


@pytest.mark.parametrize(("name", "content", "said"), [
    ("a.json", "{", "not JSON"), ("a.json", b"\xff\xfe", "not a text file"),
    ("a.txt", "hello", "neither a bag"), ("none.json", None, "cannot read"),
    ("a.json", json.dumps(DIAGNOSED | {"verdict": 3}), "verdict"),
])  # fmt: skip
def test_a_file_without_a_result_is_refused_in_one_line(name, content, said, tmp_path, lab, capsys):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["report", str(lab / "bag"), str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error and str(path) in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()

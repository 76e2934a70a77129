"""Cards of results: made from facts by templates, the same everywhere."""

import copy
import json
import re
import shutil
from pathlib import Path

import jinja2
import pytest
import yaml

from sma_bench import results
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.result import identification_from

RESULTS = yaml.safe_load(Path(__file__).with_name("results.yaml").read_text())
DIAGNOSED, IDENTIFIED = RESULTS["diagnosis"], RESULTS["identification"]
WIRE, ROOM = "wire.resistance", "environment.ambient_temperature"
KELVIN = IDENTIFIED["parameters"][ROOM]


def diagnosed(**changes):
    return diagnosis_from(copy.deepcopy(DIAGNOSED) | changes, "gap.json")


def identified(**changes):
    return identification_from(copy.deepcopy(IDENTIFIED) | changes, "found.json")


def rows(result, asked=None):
    found, last = {}, ""
    for label, text in results.card(result, asked).rows:
        last = label or last
        found.setdefault(last, []).append(text)
    return found


def test_a_card_carries_the_facts_of_a_diagnosis():
    found = rows(diagnosed())
    assert list(found) == ["cause", "where", "error", "rivals", "other", "missing", "next"]
    assert "0.3012 ± 0.0021 ohm" in found["cause"][0] and "80 %" in found["where"][0]
    worst, quiet = found["error"]
    assert worst.startswith("current") and "98 % [95, 99]" in worst and "temperature" in quiet
    moved = {"name": "wire.mass", "change": 1e-6, "unit": "kg", "deviations": 4.0}
    assert "wire.mass" in rows(diagnosed(moved=[moved]))["moved"][0]
    both = [{"signal": f"wire.{q}", "needed": 0.01, "with_best": 0.0}
            for q in ("temperature", "current")]
    (drifted,) = rows(diagnosed(drifts=both))["drift"]
    assert "wire.temperature by 0.01 K" in drifted and "wire.current by 10 mA" in drifted
    proposed = {"separates": ["slack", "supply_drop", *"abc"], "chance": 0.8, "minutes": 2.5}
    for kind, own in (("E6", "why"), ("protocol", "80 %")):
        about = proposed | {"kind": kind, "why": "why, with the chance", "protocol": {"name": kind}}
        (said,) = rows(diagnosed(next_experiment=about))["next"]
        for fact in (kind, own, "slack", "2 more", "2.5 min"):
            assert fact in said
        assert ("80 %" in said) != ("why" in said)


VERDICTS = ["effect", "ambiguous", "no_gap", "recalibration", "unexplained"]


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_its_own_title_and_a_next_step_that_fits_the_command(verdict):
    cause = ["supply_drop"] if verdict == "effect" else []
    result = diagnosed(verdict=verdict, cause=cause)
    assert (results.card(result).title == results.card(diagnosed()).title) == bool(cause)
    found = rows(result)
    assert any("zeros" in line for line in found["error"]) == (verdict == "no_gap")
    assert ("cause" in found) == bool(cause) and ("where" in found) == (verdict != "no_gap")
    plain = results.Invocation(("a bag",))
    given = results.Invocation(("a bag",), "", "better.yaml", "page")
    (before,), (after,), (nothing,) = (rows(result, i)["next"] for i in (plain, given, None))
    if verdict in ("effect", "recalibration", "unexplained"):
        option = "--report" if verdict == "unexplained" else "--out"
        assert option in before and option not in after.replace("--out simulated", "")
        assert option not in nothing.replace("--out simulated", "")
        assert ("page" if verdict == "unexplained" else "better.yaml") in after


def test_numbers_are_shown_with_both_errors_and_the_stated_value():
    resistance, ambient = results.number_rows(identified())
    off = ("+3.7 % (+3.7 std)", "98 %", "2.700 ± 0.010 ohm")
    assert resistance == (WIRE, "2.800 ± 0.0070 ± 0.024 ohm", *off, "E1, warned")
    assert ambient == (ROOM, "296.40 ± 0.50 K", "", "", "", "")
    found = rows(identified())
    assert WIRE in found["off"][0] and "-0.70" in found["linked"][0]
    assert results.two_errors(Estimate(2.0, 0.0)) == "2"
    # Columns that do not fit are left out, the least important first.
    for width, header in ((200, "informed"), (90, "difference"), (40, "systematic")):
        table = results.card_text(identified(), width).splitlines()[1:3]
        assert table[0].endswith(header if width < 200 else "by") and header in table[0]
        assert table[1].startswith(f"{WIRE} ")
    # A number that is rounded to 0 has no sign.
    near = KELVIN | {"value": 296.15 - 1e-4, "stated": {"value": 296.15, "std": 0.5}}
    (row,) = results.number_rows(identified(parameters={ROOM: near}))
    assert "(0.0 std)" in row[2]
    shares = [results.percent(share) for share in (0.001, 0.5, 0.9999)]
    assert shares == ["below 1 %", "50 %", "above 99 %"]
    for value, std, text in (
        (3.11755, 0.0004, "3.11755 ± 0.00040"), (0.25, 0.65, "0.25 ± 0.65"),
        (57.61e9, 1.6e9, "5.76e+10 ± 1.6e+09"), (1.5, 0.0, "1.5"), (2.0, float("nan"), "2"),
        (-1e-5, 1e-5, "-1.0e-05 ± 1.0e-05"), (10912.3, 1540.0, "10900 ± 1500"),
        (4.1, 9.5e-16, "4.1"), (1e-7, 0.02, "0 ± 0.020"),
    ):  # fmt: skip
        assert results.with_error(value, std) == text
    assert results.two_errors(Estimate(337.1, 3.0, "K", systematic=5e-8)) == "337.1 ± 3.0 ± 0 K"
    modulus = Estimate(57.61e9, 1.6e9, "Pa")
    assert results.two_errors(modulus) == "57.6 ± 1.6 GPa"
    assert results.with_unit("Pa", 55.4e9, 0.5e9) == "55.40 ± 0.50 GPa"
    assert results.two_errors(Estimate(-1.5e-7, 2e-8, "K/Pa")) == "-0.150 ± 0.020 K/MPa"


def test_a_result_that_is_read_back_shows_what_the_fresh_one_did_and_no_program_reads_a_sentence(
    tmp_path, monkeypatch
):
    before = []
    for result, read in ((diagnosed(), diagnosis_from), (identified(), identification_from)):
        again = read(json.loads(results.json_text(result.to_json())), "again.json")
        assert str(again) == str(result)
        assert results.json_text(again.to_json()) == results.json_text(result.to_json())
        assert again.to_json()["card"][0] == ["", results.card(result).title]
        before.append(json.loads(results.json_text(again.to_json())))
    # The templates with all of their own letters replaced.
    other = shutil.copytree(results.TEMPLATES, tmp_path / "other")
    for path in other.glob("*.j2"):
        tokens = jinja2.Environment(autoescape=True).lex(path.read_text())
        words = (re.sub(r"[^\W\d_]", "ж", t) if kind == "data" else t for _, kind, t in tokens)
        path.write_text("".join(words))
    monkeypatch.setattr(results, "TEMPLATES", other)
    monkeypatch.setattr(results, "_templates", results._templates.__wrapped__)  # read anew
    for result, one in zip((diagnosed(), identified()), before, strict=True):
        found = json.loads(results.json_text(result.to_json()))
        changed = {key for key in one if one[key] != found[key]}
        assert "card" in changed <= {"card", "gap", "why"}  # only texts for users
        assert "ж" in results.card_text(result) and "ж" in results.card_html(result)
    gaps = zip(before[0]["gap"], diagnosed().to_json()["gap"], strict=True)
    assert all((a["is_gap"], a["values"]) == (b["is_gap"], b["values"]) for a, b in gaps)


def test_text_and_page_hold_the_same_and_no_markup_of_a_name():
    hostile = diagnosed(cause=["<b>x\x1b[2J\n| y"])
    text, page = results.card_text(hostile), results.card_html(hostile)
    assert "\x1b" not in text and "<b>" not in page and "&lt;b&gt;" in page
    assert len(rows(hostile)) == len(rows(diagnosed()))
    assert "<b>" not in results.card_html(identified())
    lines = results.card_text(diagnosed()).splitlines()
    narrow = results.card_text(diagnosed(), 60).splitlines()
    assert max(map(len, lines)) <= 96 and max(map(len, narrow)) <= 60
    assert " ".join(narrow).split() == " ".join(lines).split()


@pytest.mark.parametrize(("read", "document", "named"), [
    (identification_from, {"correlation": {"names": ["a"], "matrix": [[1, 0]]}}, "correlation"),
    (identification_from, {"parameters": {"a": {"value": "2", "std": 1}}}, "value"),
    (diagnosis_from, {"verdict": "guilty"}, "verdict"), (diagnosis_from, {"where": 3}, "where"),
    (diagnosis_from, {"cause": [1e200]}, "1e+200"), (diagnosis_from, [], "damaged"),
])  # fmt: skip
def test_a_damaged_result_is_one_line_that_names_the_field(read, document, named):
    whole = IDENTIFIED if read is identification_from else DIAGNOSED
    with pytest.raises(InputError) as refused:
        read(whole | document if document else document, "r.json")
    line = str(refused.value)
    assert line.startswith("r.json: ") and named in line and "\n" not in line

"""Files of isobaric and tensile tests, good and bad."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.records import open_record
from sma_bench.records.instruments import IsobaricRecord, find_cycles
from sma_bench.records.open import open_records

CASES = yaml.safe_load(Path(__file__).with_name("mechanical_files.yaml").read_text())


def loop(points=60, step=0.03):
    """(n, 3) degC, strain, MPa of one cycle from 20 to 100 degC and back."""
    up = np.linspace(20.0, 100.0, points)
    fall, rise = (step / (1.0 + np.exp((up - middle) / 2.0)) for middle in (70.0, 50.0))
    strain = np.concatenate([fall, rise[::-1]])
    return np.column_stack([np.concatenate([up, up[::-1]]), strain, np.full(2 * points, 100.0)])


PERCENT = loop() * (1.0, 100.0, 1.0)
KSI = loop() * (1.0, 100.0, 1.0 / 6.894757293)
STRETCHED = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 400, 50)])
NOISE = 0.5 * np.random.default_rng(1).standard_normal(600)
ROWS = {
    "strain": loop(), "percent": PERCENT, "ksi": KSI, "two": PERCENT[:, :2],
    "kelvin": loop() + (273.15, 0.0, 0.0), "pascal": loop() * (1.0, 1.0, 1e3),
    "millimetres": loop() * (1.0, 50.0, 1.0), "newtons": PERCENT * (1.0, 1.0, 0.0707),
    "three cycles": np.vstack([loop()] * 3),
    "noisy": loop(300) + np.column_stack([NOISE, 0.0 * NOISE, 0.0 * NOISE]),
    "loaded": np.vstack([np.column_stack([np.full(30, 20.0), np.full(30, 0.03),
                                          np.linspace(0.0, 95.0, 30)]), loop()]),
    "flat": np.column_stack([20.0 + 0.01 * np.arange(120), loop()[:, 1:]]),
    "cold": np.where(np.arange(360).reshape(120, 3) == 21, -300.0, loop()),
    "levels": np.vstack([PERCENT, PERCENT * (1, 1, 2)]), "compressed": PERCENT * (1, 1, -1),
    "specimens": np.column_stack([np.repeat([1, 2], 120), np.vstack([PERCENT] * 2)]),
    "wide": np.column_stack([PERCENT[:, 0] + 9.0, PERCENT[:, 0], -0.4 * PERCENT[:, 1],
                             PERCENT[:, 1:]]),
    "twice": np.column_stack([PERCENT, PERCENT[:, 0], 1.1 * PERCENT[:, 1], PERCENT[:, 2]]),
    "in two units": np.column_stack([PERCENT, PERCENT[:, 0] + 273.15]),
    "contracting": PERCENT * (1.0, -1.0, 1.0) + (0.0, PERCENT[0, 1], 0.0),
    "to 6": np.column_stack([np.linspace(0, 6, 60), 80 * np.linspace(0, 6, 60)]),
    "pushed": -STRETCHED, "stretched": STRETCHED, "stretched newtons": STRETCHED * (1.0, 0.075),
    "counted": np.column_stack([STRETCHED, np.ones(50)]),
    "warmed": np.column_stack([STRETCHED, np.linspace(23.0, 31.0, 50)])}


def lines_of(rows, separator=","):
    return [separator.join(f"{v:.9e}" for v in row) for row in rows]


@pytest.fixture
def write(tmp_path):
    """Writes lines as a file."""

    def write(lines, encoding="utf-8"):
        path = tmp_path / "100 MPa.txt"
        path.write_bytes("\n".join([*lines, ""]).encode(encoding))
        return path

    return write


def heights(record):
    """Range of strain of each branch of the first cycle."""
    return [np.ptp(branch.strain) for branch in record.cycles[0].branches]


def facts(record):
    said = " | ".join(finding.text for finding in record.findings)
    if not isinstance(record, IsobaricRecord):
        return vars(record) | {"said": said, "strain": record.strain[-1],
                               "stress": record.stress[-1]}
    first = record.cycles[0].branches[0]
    return {"said": said, "stress": record.stress, "heights": heights(record),
            "unit": record.strain_unit, "begins": first.temperature[0], "first": first.strain[0],
            "least": first.stress.min(), "numbers": [cycle.number for cycle in record.cycles],
            "directions": [[b.direction for b in c.branches] for c in record.cycles]}


@pytest.mark.parametrize(("rows", "head", "expected"), CASES["cases"])
def test_a_mechanical_file_is_read_or_refused(write, rows, head, expected):
    expected = dict(expected)
    how = {key: expected.pop(key, default) for key, default in (
        ("separator", ","), ("decimal", "."), ("encoding", "utf-8"), ("line", None), ("state", {}))}
    rows = [line.replace(".", how["decimal"]) for line in lines_of(ROWS[rows], how["separator"])]
    lines = [*head.splitlines(), *rows]
    lines[30:30] = [how["line"]] if how["line"] else []
    path, refused = write(lines, how["encoding"]), expected.pop("refused", None)
    if refused:
        with pytest.raises(InputError, match=refused) as caught:
            open_record(path, stated=how["state"])
        assert "\n" not in str(caught.value)
        return
    found = facts(open_record(path, stated=how["state"]))
    said = expected.pop("said", None)
    assert said is None or (said in found["said"] if said else not found["said"])
    for name, value in expected.items():
        loose = {"heights": 1e-3, "stress": 2e-5}.get(name, 1e-6)
        plain = value is None or isinstance(value, str) or name in ("directions", "numbers")
        assert found[name] == (value if plain else pytest.approx(value, rel=loose)), name


@pytest.mark.parametrize(("head", "line", "times", "said"), CASES["refused"])
def test_a_file_without_a_test_is_refused_in_one_line(write, head, line, times, said):
    with pytest.raises(InputError, match=said) as caught:
        open_record(write([head + line * times]))
    assert "\n" not in str(caught.value)


@settings(max_examples=30, deadline=None)
@given(turns=st.lists(st.floats(30.0, 100.0), min_size=2, max_size=6), noise=st.floats(0.0, 0.5))
def test_branches_have_their_direction_and_alternate(turns, noise):
    ends = [20.0, *(120.0 + turn if i % 2 == 0 else 20.0 for i, turn in enumerate(turns))]
    t = np.concatenate([np.linspace(a, b, 50) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    t = t + 273.15 + noise * np.random.default_rng(0).standard_normal(len(t))
    cycles, _ = find_cycles(t, np.arange(len(t)) * 1.0, np.ones(len(t)), "x")
    for cycle in cycles:
        directions = [b.direction for b in cycle.branches]
        assert len(directions) == len(set(directions))
        for b in cycle.branches:
            assert (b.temperature[-1] > b.temperature[0]) == (b.direction == "heating")
            assert np.all(np.diff(b.strain) > 0.0)


def test_blocks_with_other_loads_or_units_are_separate_tests(write):
    titles, rows = "Temperature (C),Strain (%)", lines_of(PERCENT[:, :2])
    blocks = [[f"Stress: {load} MPa", titles, *rows] for load in (100, 200, 300)]
    records = open_records(write(sum(blocks, [])))
    assert [r.stress for r in records] == pytest.approx([100e6, 200e6, 300e6])
    assert [len(r.cycles) for r in records] == [1, 1, 1]
    again = write([*blocks[0], "", titles, *rows])
    assert [len(r.cycles) for r in open_records(again)] == [2]
    units = ["Temperature,Strain,Stress", "C,%,ksi"], ["Temperature,Strain,Stress", "C,mm/mm,MPa"]
    for record in open_records(write([*units[0], *lines_of(KSI), *units[1], *lines_of(loop())])):
        assert record.stress == pytest.approx(100e6, rel=1e-4)
        assert heights(record) == pytest.approx([0.03, 0.03], rel=1e-3)


def test_overflowed_cells_do_not_split_a_table(write):
    lines = ["Temperature (C),Strain (%),Stress (MPa)", *lines_of(PERCENT)]
    lines[30:34] = [f"{line.partition(',')[0]},****,****" for line in lines[30:34]]
    record = open_record(write(lines))
    assert record.account.rows == 116 and "4 lines of text" in str(record.account)
    assert [len(cycle.branches) for cycle in record.cycles] == [2]


def test_percent_cells_of_a_workbook_are_read_as_shown(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Temperature (C)", "Strain (%)", "Stress (MPa)"])
    for row in loop().tolist():
        book.active.append(row)
        book.active.cell(book.active.max_row, 2).number_format = "0.00%"
    book.save(tmp_path / "seen.xlsx")
    assert heights(open_record(tmp_path / "seen.xlsx")) == pytest.approx([0.03, 0.03], rel=1e-3)


def test_measured_files_and_seven_cycles_of_a_load_frame_are_read(measured_data):
    folder = measured_data / "sma_react" / "input"
    directions = {"cal_sample_1": ["cooling", "heating"], "cal_sample_2": ["heating", "cooling"]}
    for sample, expected in directions.items():
        for path in sorted((folder / sample).glob("*MPa.txt")):
            record = open_record(path)
            assert record.stress == pytest.approx(float(path.stem.split()[0]) * 1e6, rel=0.01)
            assert [b.direction for b in record.cycles[0].branches] == expected
            (finding,) = record.findings
            assert max(heights(record)) < 0.04 and "is taken as" in finding.text
    path = folder / "preprocessor_samples" / "isobaric_7cycle.txt"
    found = facts(record := open_record(path))
    assert found["directions"] == [[b.direction for b in record.cycles[0].branches]] * 7
    assert found["unit"] == "relative" and "537 rows of loading" in found["said"]
    assert "more than any NiTi endures" in found["said"]
    scaled = open_record(path, stated={"gauge_length": 0.4})
    assert scaled.strain_unit == "1"
    assert scaled.cycles[0].branches[0].strain.max() == pytest.approx(0.0555, rel=0.02)

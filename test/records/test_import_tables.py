"""Tables of other loggers: four formats of one bench, guesses and questions, hostile files."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from unfolding_tables import TEXT, shared_array, shared_texts, unfolding_tables

from sma_bench import border
from sma_bench.api import load
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.records import describe, open_record, read_record
from sma_bench.records.import_map import read_map
from sma_bench.records.tables import read_table_file

h5py = pytest.importorskip("h5py")
pytest.importorskip("openpyxl")
io = pytest.importorskip("scipy.io")
sparse = pytest.importorskip("scipy.sparse")

CASES = yaml.safe_load(Path(__file__).with_name("import_tables.yaml").read_text())
SUPPLY = 12.0
RIG = """/**:
  ros__parameters:
    bench: {channels: [wire], channel_sides: [front], drive: duty, supply_voltage: 12.0}
    load: {kind: spring, stiffness: 200.0, preload: 6.0}
    wire: {length: 0.38, resistance: 7.0}
"""
TIME = np.round(np.arange(600) * 0.05, 6)
DUTY = np.where((TIME > 5) & (TIME < 15), 0.125, 0.0)
MOVED = np.round(0.012 * np.clip((TIME - 5) / 5, 0, 1) * np.exp(-np.clip(TIME - 15, 0, 99) / 3), 6)
PLACE = 0.0123 + MOVED  # grows as the wire shortens


def text_file(path, titles, columns):
    rows = [",".join(f"{v:.10g}" for v in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([",".join(titles), *rows]) + "\n")
    return path


def write_csv(folder):
    titles = ["time [ms]", "duty [%]", "position [mm]"]
    return text_file(folder / "a.csv", titles, [TIME * 1e3, DUTY * 100, PLACE * 1e3])


def write_mat(folder):
    position = {"time": TIME, "signals": {"values": PLACE, "label": "slider_m"}}
    duty = {"time": TIME[::2], "signals": {"values": DUTY[::2], "label": "duty"}}
    io.savemat(folder / "c.mat", {"Position": position, "Duty": duty})
    return folder / "c.mat"


def write_hdf5(folder):
    columns = {"t": (TIME, "s"), "u": (np.sqrt(DUTY) * SUPPLY, "V_rms"), "x": (-PLACE * 1e3, "mm")}
    with h5py.File(folder / "e.h5", "w") as file:
        for name, (values, unit) in columns.items():
            file.create_dataset(f"log/{name}", data=values).attrs["unit"] = unit
    return folder / "e.h5"


def write_parquet(folder):
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = arrow.table({"time_s": TIME, "duty_%": DUTY * 100, "position_mm": PLACE * 1e3})
    parquet.write_table(table, folder / "f.parquet")
    return folder / "f.parquet"


WRITERS = [write_csv, write_mat, write_hdf5, write_parquet]


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


def imported(source, rig, out, *more):
    assert main(["import", str(source), "--params", str(rig), "--out", str(out), *more]) == 0
    return read_record(out)


@pytest.mark.parametrize("write", WRITERS)
def test_every_format_gives_the_same_record_of_the_bench(write, tmp_path, rig):
    record = imported(write(tmp_path), rig, tmp_path / "bag")
    volts, moved = record["wire.voltage"], record["elongation"]
    expected = np.interp(volts.time, TIME, np.sqrt(DUTY) * SUPPLY)
    np.testing.assert_allclose(volts.values, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moved.values, -np.interp(moved.time, TIME, MOVED), atol=2e-9)
    np.testing.assert_allclose(np.diff(volts.time), volts.period, atol=1e-6)


def test_a_bag_says_where_it_comes_from_and_its_map_gives_it_again(tmp_path, rig):
    first, second = write_csv(tmp_path), tmp_path / "b day.csv"
    second.write_bytes(first.read_bytes())
    once = imported(first, rig, tmp_path / "bag", "--json", str(tmp_path / "r.json"))
    sha = json.loads((tmp_path / "r.json").read_text())["imported"][0]["sha256"]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    custom = metadata["rosbag2_bagfile_information"]["custom_data"]
    assert json.loads(custom["sma_bench_provenance"])["sha256"] == sha
    told = " ".join(f["text"] for f in describe(open_record(tmp_path / "bag"))["findings"])
    assert sha in told and "sqrt(duty) x 12 V" in told
    words = ["--map", str(tmp_path / "bag.map.yaml"), "--out", str(tmp_path / "week")]
    assert main(["import", str(first), str(second), *words]) == 0
    for name in ("a", "b_day"):
        again = read_record(tmp_path / "week" / name)
        for signal in once.signals.values():
            np.testing.assert_array_equal(again[signal.name].values, signal.values)


@pytest.mark.parametrize(("titles", "scale", "said"), CASES["asked"])
def test_what_is_unsure_is_asked_in_one_line_and_in_the_map(
    titles, scale, said, tmp_path, rig, capsys
):
    columns = [c * s for c, s in zip((TIME, DUTY, PLACE), scale, strict=True)]
    source = text_file(tmp_path / "odd.csv", titles, columns)
    bag, asked = tmp_path / "bag", tmp_path / "bag.map.yaml"
    words = ["import", str(source), "--params", str(rig), "--out", str(bag)]
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and said in line and "bag.map.yaml" in line
    assert not bag.exists() and "ASK" in asked.read_text()
    if said == "no unit is given":  # as it is, the map answers nothing; filled in, it imports
        assert main([*words, "--map", str(asked)]) == 2 and not bag.exists()
        assert "unit is 'ask'" in capsys.readouterr().err
        document = yaml.safe_load(asked.read_text().replace("unit: ask", "unit: mm"))
        for entry in document["signals"]:
            entry["scale"] = 1e3 / 77 if entry["signal"] == "elongation" else 1.0
        asked.write_text(yaml.safe_dump(document))
        record = imported(source, rig, bag, "--map", str(asked))
        np.testing.assert_allclose(record["elongation"].values, -MOVED, atol=1e-8)


@pytest.mark.parametrize(("entry", "said"), CASES["entries"])
def test_a_value_that_a_map_does_not_have_is_named_with_its_place(entry, said, tmp_path):
    text = "time: {t: s}\nsignals: [{signal: wire.voltage, column: u, unit: V, clock: t, %s}]\n"
    path = tmp_path / "x.map.yaml"
    path.write_text((text % entry).replace("clock: t, clock", "clock"))
    with pytest.raises(InputError, match=said):
        read_map(path)


def test_other_commands_say_how_a_table_becomes_a_record(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    by_input = "simulate --out bag --input {}"
    for write, words in ((write_csv, "identify {}"), (write_mat, by_input)):
        source = write(tmp_path).name
        assert main(words.format(source).split()) == 2
        error = capsys.readouterr().err
        assert f"sma-bench import {source} --out" in error and error.count("\n") == 1


def test_what_needs_no_duty_or_no_position_is_read(tmp_path, rig):
    """A pull by a load frame, from arrays and from a file; a clamped wire; currents, angles."""
    pull = np.interp(TIME, [0, 10, 20, 30], [0, 6e-3, 0, 0])
    arrays = load({"time": TIME, "elongation": pull, "force": pull * 9e3})
    assert arrays["force"].values.max() == pytest.approx(54)
    titles = ["t (s)", "elongation (mm)", "force (N)"]
    pulled = load(text_file(tmp_path / "t.csv", titles, [TIME, 1e3 * pull, -9e3 * pull]), units={})
    np.testing.assert_allclose(pulled["elongation"].values, pull, atol=1e-12)
    np.testing.assert_allclose(pulled["force"].values, 9e3 * pull, atol=1e-9)
    titles = ["time [s]", "duty [%]", "temperature [degC]"]
    clamped = text_file(tmp_path / "h.csv", titles, [TIME, DUTY * 100, 23.0 + 400.0 * DUTY])
    assert set(load(clamped, params=rig).signals) == {"wire.voltage", "wire.temperature"}
    # What a machine imposes is as it counts: heat, which comes with it, tells nothing of its sign.
    machine = tmp_path / "machine.yaml"
    machine.write_text(RIG.replace("{kind: spring, stiffness: 200.0, preload: 6.0}",
                                   "{kind: displacement}"))
    titles = ["time [s]", "duty [%]", "displacement [mm]", "force [N]"]
    columns = [TIME, DUTY * 100, 1.5 + 1e3 * MOVED, 20.0 - 1e3 * MOVED]
    moved = load(text_file(tmp_path / "m.csv", titles, columns), params=machine)["elongation"]
    np.testing.assert_allclose(moved.values, 1.5e-3 + MOVED, atol=1e-9)
    titles = ["t (s)", "strom (mA)", "winkel (grad)"]
    turned = text_file(tmp_path / "w.csv", titles, [TIME, 800.0 * (DUTY > 0), MOVED * 4e3])
    with pytest.raises(InputError, match=r"m of movement for a radian\? load.lever"):
        load(turned, units={})
    rig.write_text(RIG.replace("6.0}", "6.0, lever: 0.02}").replace("duty", "current"))
    record = imported(turned, rig, tmp_path / "bag")
    assert record["wire.current"].values.max() == pytest.approx(0.8)
    moved = -np.radians(MOVED * 4e3) * 0.02
    np.testing.assert_allclose(record["elongation"].values, moved, atol=1e-9)
    # Watts drive where the rig says so.
    titles = ["t (s)", "leistung (mW)", "position (mm)", "volts (V)"]
    watts = 3.0 * (DUTY > 0)
    columns = [TIME, 1e3 * watts, MOVED * 1e3, 9.0 + 0.0 * TIME]
    table = text_file(tmp_path / "p.csv", titles, columns)
    rig.write_text(RIG.replace("duty", "power"))
    record = imported(table, rig, tmp_path / "power")
    product = record["wire.voltage"].values * record["wire.current"].values
    np.testing.assert_allclose(product, watts, atol=1e-6)
    rig.write_text(RIG.replace("duty", "voltage"))
    record = imported(table, rig, tmp_path / "voltage")
    assert np.all(record["wire.voltage"].values == 9.0) and "wire.current" not in record.signals
    alone = text_file(tmp_path / "q.csv", titles[:3], columns[:3])
    with pytest.raises(InputError, match="power drives with bench.drive: power only"):
        load(alone, params=rig)
    rig.write_text(RIG.replace("6.0}", "6.0, lever: 0.02}").replace("duty", "current"))
    # The rig that turns an angle into movement serves other commands too.
    words = "simulate --protocol ramp --rate 10 --set bench.drive=duty"
    assert main([*words.split(), "--params", str(rig), "--out", str(tmp_path / "model")]) == 0


MATLAB = b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\0\1IM"
MAGIC = [b"", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", MATLAB, b"PAR1", b"t,u\n"]


@settings(max_examples=12, deadline=None)
@given(st.binary(max_size=400), st.sampled_from(MAGIC))
def test_any_bytes_are_a_table_or_one_line(tmp_path_factory, content, magic):
    path = tmp_path_factory.mktemp("h") / "x.bin"
    path.write_bytes(magic + content)
    try:
        assert read_table_file(path).columns
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)


INFO = """
import resource, sys
from sma_bench.cli import main
from sma_bench.commands import terminal
terminal.FIRST_LINE = 1e6  # no line of progress on a busy machine: lines are counted
statuses = [main(["info", name]) for name in sys.argv[1:]]
own, children = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(*statuses, max(own.ru_maxrss, children.ru_maxrss))
"""


def test_what_a_table_holds_once_and_refers_to_often_ends_info_in_a_line_and_a_gigabyte(tmp_path):
    """In their libraries these take 5.7 to 8.8 GB."""
    pytest.importorskip("pyarrow")
    tables = unfolding_tables(tmp_path)
    command = [sys.executable, "-c", INFO, *map(str, tables)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    *statuses, peak = map(int, ended.stdout.split())
    assert statuses == [2, 2, 2]
    for line, table in zip(ended.stderr.splitlines(), tables, strict=True):
        assert line.startswith(f"sma-bench: {table}: ")
    assert peak * 1024 < 1 << 30


def test_tables_that_unfold_without_end_are_refused_or_read_without_it(tmp_path, monkeypatch):
    """What they claim, what they hold once and refer to often, and other files."""
    with h5py.File(tmp_path / "claims.h5", "w") as file:
        file.create_dataset("t", shape=(1 << 40,), chunks=(1 << 16,), dtype="f8")
    (tmp_path / "secret").write_bytes(bytes(800))
    with h5py.File(tmp_path / "outside.h5", "w") as file:
        file.create_dataset("t", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
    shared_array(tmp_path / "often.h5")
    refused = {"claims.h5": "more than [0-9]+ MB", "outside.h5": "another file",
               "often.h5": "memory"}  # fmt: skip
    for name, said in refused.items():
        with pytest.raises(InputError, match=said):
            read_table_file(tmp_path / name)
    # One text of a megabyte in every cell of a column.
    one = b"<si><t>" + TEXT + b"</t></si>"
    assert len(read_table_file(shared_texts(tmp_path / "often.xlsx", 1000, one)).columns) == 2
    monkeypatch.setattr(border, "_SECONDS", 0.5)
    endless = shared_texts(tmp_path / "endless.xlsx", 1000, b"<si><t>x</t></si>" * 1_000_000)
    with pytest.raises(InputError, match="takes more than 1 s"):
        read_table_file(endless)


def test_a_damaged_matlab_file_ends_in_one_line_and_what_is_no_series_is_named(tmp_path):
    plain, odd = tmp_path / "plain.mat", tmp_path / "odd.mat"
    io.savemat(plain, {"t": np.arange(40) / 7.0, "s": {"u": np.arange(40) * 1.5}})
    content = plain.read_bytes()
    doubles = (9).to_bytes(4, "little") + (320).to_bytes(4, "little")
    assert content.count(doubles) == 2 and len(read_table_file(plain).columns) == 2
    altered = [content.replace(doubles, bytes([kind, 0, 0, 0]) + doubles[4:])
               for kind in (0, 10, 14, 255)]  # fmt: skip
    altered += [content[:144] + word.to_bytes(4, "little") + content[148:]
                for word in (0x0806, 0x0805, 0x0005)]  # fmt: skip
    for content in altered:
        odd.write_bytes(content)
        with pytest.raises(InputError, match=f"{odd}: [^\\n]*$"):
            read_table_file(odd)
    series = {"t": np.arange(40) / 7.0, "z": np.arange(40) * (1.0 + 1.0j), "s": sparse.eye(40)}
    io.savemat(odd, {**series, "two": [{"u": np.arange(40.0)}, {"u": np.arange(40.0)}]})
    file = read_table_file(odd)
    assert [c.name for c in file.columns] == ["t", "two.1.u", "two.2.u"]
    assert file.outside == ("z (no array of numbers)", "s (no array of numbers)")


@pytest.mark.parametrize(("text", "said"), CASES["broken"])
def test_a_broken_table_is_one_line_that_says_where_and_leaves_no_bag(
    text, said, tmp_path, rig, capsys
):
    (tmp_path / "x.csv").write_text(text)
    words = ["import", str(write_csv(tmp_path)), str(tmp_path / "x.csv"), "--params", str(rig)]
    assert main([*words, "--out", str(tmp_path / "week")]) == 2
    line = capsys.readouterr().err
    assert said in line and line.count("\n") == 1
    assert not (tmp_path / "week").exists()


def test_the_file_that_parameters_writes_is_a_rig_whose_zero_length_says_nothing(tmp_path):
    lab, bag = tmp_path / "lab.yaml", tmp_path / "bag"
    assert main(["parameters", "--out", str(lab)]) == 0
    titles = ["time [s]", "voltage [V]", "elongation [mm]"]
    source = text_file(tmp_path / "v.csv", titles, [TIME, DUTY, MOVED * 1e3])
    assert len(imported(source, lab, bag).signals) == 2
    lab.write_text(RIG.replace("0.38", "-1"))
    with pytest.raises(InputError, match="wire.length is -1 m, expected 0 to 100"):
        load(source, params=lab)


def test_units_in_the_column_behind_are_each_numbers_own(tmp_path):
    """As a multimeter writes that chooses its range."""
    path = tmp_path / "dmm.csv"
    path.write_text("Time (s),Voltage,Unit\n0,0.5,mV\n1,3.24,V\n2,120,mV\n3,3.3,V\n")
    _, voltage = read_table_file(path).columns
    assert voltage.unit == "mV"
    assert voltage.values == pytest.approx([0.5, 3240.0, 120.0, 3300.0])
    path.write_text("Time (s),Voltage,Unit\n0,0.5,mV\n1,3.24,lot 7\n2,120,mV\n")
    assert read_table_file(path).columns[1].unit == ""


LABVIEW = """LabVIEW Measurement
Separator\tTab
Decimal_Separator\t,
Multi_Headings\tYes
Date\t2026/03/01
Time\t10:00:00,123
***End_of_Header***

Channels\t2
Samples\t4\t4
Date\t2026/03/01\t2026/03/01
Time\t10:00:00\t10:00:00
Y_Unit_Label\tVolts\tmm
X_Dimension\tTime\tTime
X0\t0,0E+0\t0,0E+0
Delta_X\t0,5\t0,5
***End_of_Header***
X_Value\tDrive\tPosition\tComment
0,0\t0,25\t20,5
0,5\t1,25\t20,25
1,0\t1,25\t19,5
1,5\t0,0\t19,75
"""


@pytest.mark.parametrize("text", [LABVIEW, LABVIEW.replace(",", ".")])
def test_labviews_header_is_no_table_and_has_the_units(tmp_path, text):
    path = tmp_path / "run.lvm"
    path.write_text(text)
    (table,) = read_table_file(path).tables
    assert [(c.title, c.unit) for c in table.columns] == [
        ("Time", "s"), ("Drive", "Volts"), ("Position", "mm")
    ]  # fmt: skip
    assert table.columns[2].values.tolist() == [20.5, 20.25, 19.5, 19.75]
    # Without a header too, the comment is a title that no row has.
    path.write_text(text.partition("***\nX")[2].replace("_Value", "X_Value", 1))
    assert [c.title for c in read_table_file(path).columns] == ["X_Value", "Drive", "Position"]


def test_a_scale_that_an_attribute_states_is_applied_and_said(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "daq.h5"
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(5.0)
        file["voltage"] = np.arange(5.0)
        file["voltage"].attrs["gain"] = 2.0
    found = read_table_file(path)
    assert found.columns[1].values.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert found.notes == ("voltage: scale 2 of its attributes applied",)


def test_a_unit_that_is_guessed_is_said(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text("Time (s),Voltage (V),Current\n" + "".join(
        f"{k},{1.2 * (k % 4 > 1)},{0.6 * (k % 4 > 1)}\n" for k in range(20)
    ))  # fmt: skip
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "warning" in said and "Current: no unit is given; 0 to 0.6 is taken as 'A'" in said

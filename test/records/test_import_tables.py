"""Tables of other loggers: four formats of the same data, guesses and questions, hostile files."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from unfolding_tables import TEXT, dictionary_text, shared_array, shared_texts

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


@pytest.mark.parametrize(("files", "begins", "said", "start"),
                         [(*case, None)[:4] for case in CASES["joined"]])
def test_files_of_one_run_are_put_on_one_clock(tmp_path, capsys, files, begins, said, start):
    (tmp_path / "rig.yaml").write_text(RIG.replace("drive: duty, supply_voltage: 12.0", ""))
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    words = ["import", *(str(tmp_path / name) for name in files), "--together", "--params",
             str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "bag")]
    status = main(words)
    shown = capsys.readouterr()
    assert said in " ".join((shown.out + shown.err).split())
    if start:
        status = main([*words, "--start", start, "--force"])
    assert status == 0
    assert [s.time[0] for s in load(tmp_path / "bag").signals.values()] == pytest.approx(begins)


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
def test_every_format_gives_the_same_record(write, tmp_path, rig):
    record = imported(write(tmp_path), rig, tmp_path / "bag")
    volts, moved = record["wire.voltage"], record["elongation"]
    expected = np.interp(volts.time, TIME, np.sqrt(DUTY) * SUPPLY)
    np.testing.assert_allclose(volts.values, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moved.values, -np.interp(moved.time, TIME, MOVED), atol=2e-9)
    np.testing.assert_allclose(np.diff(volts.time), volts.period, atol=1e-6)


def test_a_bag_names_its_source_and_its_map_imports_the_same_again(tmp_path, rig):
    first, second = write_csv(tmp_path), tmp_path / "b day.csv"
    second.write_bytes(first.read_bytes())
    once = imported(first, rig, tmp_path / "bag", "--json", str(tmp_path / "r.json"))
    sha = json.loads((tmp_path / "r.json").read_text())["imported"][0]["sha256"]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    custom = metadata["rosbag2_bagfile_information"]["custom_data"]
    assert json.loads(custom["sma_bench_provenance"])["sha256"] == sha
    texts = " ".join(f["text"] for f in describe(open_record(tmp_path / "bag"))["findings"])
    assert sha in texts and "sqrt(duty) x 12 V" in texts
    custom["sma_bench_provenance"] = "torn {"
    (tmp_path / "bag" / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    texts = " ".join(f["text"] for f in describe(open_record(tmp_path / "bag"))["findings"])
    assert "sma_bench_provenance" in texts and "cannot be understood" not in texts
    words = ["--map", str(tmp_path / "bag.map.yaml"), "--out", str(tmp_path / "week")]
    assert main(["import", str(first), str(second), *words]) == 0
    for name in ("a", "b_day"):
        again = read_record(tmp_path / "week" / name)
        for signal in once.signals.values():
            np.testing.assert_array_equal(again[signal.name].values, signal.values)


@pytest.mark.parametrize(("titles", "scale", "said"), CASES["asked"])
def test_unclear_titles_are_asked_and_answered_in_a_map(titles, scale, said, tmp_path, rig, capsys):
    columns = [c * s for c, s in zip((TIME, DUTY, PLACE), scale, strict=True)]
    source = text_file(tmp_path / "odd.csv", titles, columns)
    bag, asked = tmp_path / "bag", tmp_path / "bag.map.yaml"
    words = ["import", str(source), "--params", str(rig), "--out", str(bag)]
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and said in line and "bag.map.yaml" in line
    assert not bag.exists() and "ASK" in asked.read_text()
    if said == "no unit is given":  # the map is refused as it is, and imports once filled in
        assert main([*words, "--map", str(asked)]) == 2 and not bag.exists()
        assert "unit is 'ask'" in capsys.readouterr().err
        document = yaml.safe_load(asked.read_text().replace("unit: ask", "unit: mm"))
        for entry in document["signals"]:
            entry["scale"] = 1e3 / 77 if entry["signal"] == "elongation" else 1.0
        asked.write_text(yaml.safe_dump(document))
        record = imported(source, rig, bag, "--map", str(asked))
        np.testing.assert_allclose(record["elongation"].values, -MOVED, atol=1e-8)


def test_a_column_that_may_be_of_the_wire_stands_in_the_map_that_asks(tmp_path, rig, capsys):
    titles = ["time [ms]", "duty [%]", "position [mm]", "IR camera [degC]", "camera temperature"]
    columns = [TIME * 1e3, DUTY * 100, PLACE * 1e3, 23.0 + 4e3 * MOVED, 30 + DUTY]
    table = text_file(tmp_path / "a.csv", titles, columns)
    out = ["--params", str(rig), "--out", str(tmp_path / "run")]
    assert main(["import", str(table), *out]) == 2
    said = capsys.readouterr().err
    assert "'IR camera [degC]': of the wire, or of another device (camera)?" in said
    assert main(["import", str(table), "--map", str(tmp_path / "run.map.yaml"), *out]) == 0
    record = read_record(tmp_path / "run")
    assert np.ptp(record["wire.temperature"].values) == pytest.approx(4e3 * np.ptp(MOVED), rel=1e-3)


@pytest.mark.parametrize(("entry", "said"), CASES["entries"])
def test_an_invalid_entry_of_a_map_is_named_with_its_place(entry, said, tmp_path):
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


PULL, WATTS, ON = np.interp(TIME, [0, 10, 20, 30], [0, 6e-3, 0, 0]), 3.0 * (DUTY > 0), DUTY > 0
ANGLE, POWER = ["t (s)", "strom (mA)", "winkel (grad)"], ["t (s)", "leistung (mW)", "position (mm)"]
TURNED, DRAWN = [TIME, 800.0 * ON, MOVED * 4e3], [TIME, 1e3 * WATTS, MOVED * 1e3]
IMPOSED = ("{kind: spring, stiffness: 200.0, preload: 6.0}", "{kind: displacement}")
LEVER, OF_CURRENT = ("6.0}", "6.0, lever: 0.02}"), ("duty", "current")
# Changes of the rig, titles, columns, and the signals that are read, or the error.
LOADED = [
    ([], ["t (s)", "elongation (mm)", "force (N)"], [TIME, 1e3 * PULL, -9e3 * PULL],
     {"elongation": PULL, "force": 9e3 * PULL}),
    ([], ["time [s]", "duty [%]", "temperature [degC]"], [TIME, DUTY * 100, 23.0 + 400.0 * DUTY],
     {"wire.voltage": np.sqrt(DUTY) * SUPPLY, "wire.temperature": 296.15 + 400.0 * DUTY}),
    # An imposed displacement keeps the machine's sign: heat, at the same time, does not decide it.
    ([IMPOSED], ["time [s]", "duty [%]", "displacement [mm]", "force [N]"],
     [TIME, DUTY * 100, 1.5 + 1e3 * MOVED, 20.0 - 1e3 * MOVED], {"elongation": 1.5e-3 + MOVED}),
    ([OF_CURRENT], ANGLE, TURNED, r"m of movement for a radian\? State load.lever"),
    # The name of a channel does not count as part of a title: an extensor is no extension.
    ([("[wire]", "[extensor]")], ["time [s]", "extensor duty [%]", "position [mm]"],
     [TIME, DUTY * 100, PLACE * 1e3],
     {"extensor.voltage": np.sqrt(DUTY) * SUPPLY, "elongation": -MOVED}),
    ([LEVER, OF_CURRENT], ANGLE, TURNED,
     {"wire.current": 0.8 * ON, "elongation": -np.radians(MOVED * 4e3) * 0.02}),
    # Watts drive if the rig says so.
    ([("duty", "power")], [*POWER, "volts (V)"], [*DRAWN, 9.0 + 0.0 * TIME],
     {"wire.voltage": np.sqrt(WATTS * 7.0), "wire.current": np.sqrt(WATTS / 7.0)}),
    ([("duty", "voltage")], [*POWER, "volts (V)"], [*DRAWN, 9.0 + 0.0 * TIME],
     {"wire.voltage": 9.0 + 0.0 * TIME, "wire.current": None}),
    ([("duty", "voltage")], POWER, DRAWN, "power drives with bench.drive: power only")]


@pytest.mark.parametrize("case", LOADED)
def test_tables_without_duty_or_position_are_read(case, tmp_path, rig):
    """A test in a load frame, a clamped wire; currents, angles, watts."""
    changes, titles, columns, expected = case
    for old, new in changes:
        rig.write_text(rig.read_text().replace(old, new))
    source = text_file(tmp_path / "t.csv", titles, columns)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            load(source, params=rig)
        return
    record = load(source, params=rig)
    for name, values in expected.items():
        assert (name in record.signals) == (values is not None)
        if values is not None:
            np.testing.assert_allclose(record[name].values, values, atol=2e-6)


MATLAB = b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\0\1IM"
MAGIC = [b"", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", MATLAB, b"PAR1", b"t,u\n"]


@settings(max_examples=12, deadline=None)
@given(st.binary(max_size=400), st.sampled_from(MAGIC))
def test_any_bytes_give_a_table_or_one_line(tmp_path_factory, content, magic):
    path = tmp_path_factory.mktemp("h") / "x.bin"
    path.write_bytes(magic + content)
    try:
        assert read_table_file(path).columns
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)


def test_tables_that_unfold_to_gigabytes_are_refused_or_read_in_part(tmp_path, monkeypatch):
    """By a stated size, by references to one large thing (5.7 to 8.8 GB); and other files."""
    with h5py.File(tmp_path / "claims.h5", "w") as file:
        file.create_dataset("t", shape=(1 << 40,), chunks=(1 << 16,), dtype="f8")
    (tmp_path / "secret").write_bytes(bytes(800))
    with h5py.File(tmp_path / "outside.h5", "w") as file:
        file.create_dataset("t", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
    one = b"<si><t>" + TEXT + b"</t></si>"
    refused = {tmp_path / "claims.h5": "more than [0-9]+ MB",
               tmp_path / "outside.h5": "another file",
               shared_array(tmp_path / "often.h5"): "memory"}
    for path, said in refused.items():
        with pytest.raises(InputError, match=said):
            read_table_file(path)
    # Long texts are cut, so that this one is read.
    assert len(read_table_file(shared_texts(tmp_path / "often.xlsx", 1000, one)).columns) == 2
    monkeypatch.setattr(border, "_SECONDS", 0.5)
    endless = shared_texts(tmp_path / "endless.xlsx", 1000, b"<si><t>x</t></si>" * 1_000_000)
    with pytest.raises(InputError, match="takes more than 1 s"):
        read_table_file(endless)


def test_a_column_of_texts_in_a_parquet_file_is_not_unfolded(tmp_path):
    pytest.importorskip("pyarrow")  # not among Ubuntu's packages
    assert len(read_table_file(dictionary_text(tmp_path / "often.parquet")).columns) == 2


def test_a_damaged_matlab_file_gives_one_line_and_unread_arrays_are_named(tmp_path):
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
def test_a_broken_table_gives_one_line_and_leaves_no_bag(text, said, tmp_path, rig, capsys):
    (tmp_path / "x.csv").write_text(text)
    words = ["import", str(write_csv(tmp_path)), str(tmp_path / "x.csv"), "--params", str(rig)]
    assert main([*words, "--out", str(tmp_path / "week")]) == 2
    line = capsys.readouterr().err
    assert said in line and line.count("\n") == 1
    assert not (tmp_path / "week").exists()


def test_a_wire_length_of_zero_means_unknown(tmp_path):
    lab, bag = tmp_path / "lab.yaml", tmp_path / "bag"
    assert main(["parameters", "--out", str(lab)]) == 0
    titles = ["time [s]", "voltage [V]", "elongation [mm]"]
    source = text_file(tmp_path / "v.csv", titles, [TIME, DUTY, MOVED * 1e3])
    assert len(imported(source, lab, bag).signals) == 2
    lab.write_text(RIG.replace("0.38", "-1"))
    with pytest.raises(InputError, match="wire.length is -1 m, expected 0 to 100"):
        load(source, params=lab)


@pytest.mark.parametrize(("text", "expected"), CASES["columns"])
def test_columns_have_the_titles_units_and_numbers_of_their_text(text, expected, tmp_path):
    path = tmp_path / "log.txt"
    for written in (text, text.replace(",", ".")) if "LabVIEW" in text else (text,):
        path.write_text(written)
        (table,) = read_table_file(path).tables
        assert [[c.title, c.unit] for c in table.columns] == [[*row[:2]] for row in expected]
        for column, (_, _, values) in zip(table.columns, expected, strict=True):
            assert column.values == pytest.approx(values, nan_ok=True)


@pytest.mark.parametrize(("encoding", "titles"), [
    ("gbk", "时间(s),电压(V),温度(℃)"), ("cp949", "시간(s),전압(V),온도(℃)"),
    ("cp932", "時間（ｓ）,電圧（Ｖ）,温度（℃）"), ("cp1252", "Tempo (s),Tensão (V),T (°C)"),
    ("cp1252", "Tiempo (s),Tensión (V),Posición (mm)"), ("koi8_r", "Время (с),Ток (А),T (C)"),
    ("cp1251", "Время (с),Напряжение (В),Температура (°C)"),
    ("cp866", "Время (с),Напряжение (В),Температура (C)"), ("big5", "時間(s),電壓(V),位移(mm)"),
    ("cp1253", "Χρόνος (s),Τάση (V),Θερμοκρασία (°C)"), ("euc_jp", "時間(s),電圧(V),温度(C)"),
    ("cp1250", "Čas (s),Napětí (V),Teplota (°C)"), ("cp1254", "Zaman (s),Akım (A),Sıcaklık (°C)")])
def test_code_pages_are_told_by_their_titles(encoding, titles, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes("\n".join([titles, *(f"{k},1.5,24" for k in range(5))]).encode(encoding))
    assert [c.name for c in read_table_file(path).columns] == titles.split(",")


def test_a_column_of_text_with_a_unit_is_reported(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Time (s),U (V),Force (N)\n" + "".join(f"{k},1.5,{k}.5-\n" for k in range(5)))
    assert read_table_file(path).notes == ("Force (N): text such as '0.5-'",)


def test_a_scale_in_an_attribute_is_applied_and_noted(tmp_path):
    path = tmp_path / "daq.h5"
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(5.0)
        file["voltage"] = np.arange(5.0)
        file["voltage"].attrs["gain"] = 2.0
    found = read_table_file(path)
    assert found.columns[1].values.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert found.notes == ("voltage: scale 2 of its attributes applied",)


def test_a_guessed_unit_is_reported(tmp_path, capsys):
    path = tmp_path / "log.csv"
    on = np.arange(20) % 4 > 1
    text_file(path, ["Time (s)", "Voltage (V)", "Current"], [np.arange(20), 1.2 * on, 0.6 * on])
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "warning" in said and "Current: no unit is given; 0 to 0.6 is taken as 'A'" in said

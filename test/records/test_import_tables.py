"""Tables of other loggers: five formats of one bench, guesses and questions, hostile files."""

import itertools
import json
import tracemalloc
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench import border
from sma_bench.api import load
from sma_bench.border import MEGABYTE, Budget
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import read_parameter_names
from sma_bench.records import arrays_in_files, describe, open_record, read_record
from sma_bench.records.check import check_response
from sma_bench.records.import_map import convert, read_map
from sma_bench.records.import_proposal import BenchHints, bench_of, propose
from sma_bench.records.isobaric import read_isobaric
from sma_bench.records.tables import read_table_file
from sma_bench.records.tensile import read_tensile
from sma_bench.records.units import parse_unit, split_title

h5py = pytest.importorskip("h5py")
openpyxl = pytest.importorskip("openpyxl")
io = pytest.importorskip("scipy.io")

SPRING = Path(__file__).resolve().parents[3] / "shared" / "data" / "foreign" / "spring"
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


def text_file(path, titles, columns, separator=",", decimal=".", above=(), digits=10):
    rows = [separator.join(f"{v:.{digits}g}".replace(".", decimal) for v in row)
            for row in np.column_stack(columns)]  # fmt: skip
    path.write_text("\n".join([*above, separator.join(titles), *rows]) + "\n", encoding="latin-1")
    return path


def write_csv(folder):
    return text_file(folder / "a.csv", ["time [ms]", "duty [%]", "position [mm]"],
                     [TIME * 1e3, DUTY * 100, PLACE * 1e3])  # fmt: skip


def write_european(folder):
    return text_file(
        folder / "b.txt", ["Zeit (s)", "Tastverhältnis", "Weg (mm)", "Raum (°C)"],
        [TIME, DUTY, PLACE * 1e3, np.full(len(TIME), 24.6)], ";", ",",
        ["Messung 2026-10-02 14:11:07", "Prüfer: A. B.", ""],
    )  # fmt: skip


def write_mat(folder):
    def timed(time, values, label):
        return {"time": time, "signals": {"values": values, "label": label}}

    io.savemat(folder / "c.mat", {"Position": timed(TIME, PLACE, "slider_m"),
                                  "Duty": timed(TIME[::2], DUTY[::2], "duty")})  # fmt: skip
    return folder / "c.mat"


def write_excel(folder):
    book = openpyxl.Workbook()
    for row in (["bench 3"], [], ["t", "PWM", "x"], ["s", "%", "mm"],
                *np.column_stack([TIME, DUTY * 100, PLACE * 1e3])[::2].tolist()):  # fmt: skip
        book.active.append(row)
    book.save(folder / "d.xlsx")
    return folder / "d.xlsx"


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


WRITERS = [write_csv, write_european, write_mat, write_excel, write_hdf5, write_parquet]


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
    np.testing.assert_allclose(
        volts.values, np.interp(volts.time, TIME, np.sqrt(DUTY) * SUPPLY), rtol=1e-6, atol=1e-6
    )
    np.testing.assert_allclose(moved.values, -np.interp(moved.time, TIME, MOVED), atol=2e-9)
    np.testing.assert_allclose(np.diff(volts.time), volts.period, atol=1e-6)


@pytest.mark.skipif(not SPRING.exists(), reason="shared data are not here")
def test_five_loggers_of_one_foreign_bench_agree_with_their_files_and_each_other(tmp_path):
    files = ["run_a.csv", "run_b_european.txt", "run_c.mat", "run_d.xlsx", "run_e.h5"]
    records = [imported(SPRING / f, SPRING / "rig.yaml", tmp_path / f"{k}") for k, f in
               enumerate(files)]  # fmt: skip
    a = np.loadtxt(SPRING / files[0], delimiter=",", skiprows=1)
    np.testing.assert_allclose(records[0]["elongation"].time, a[:, 0] / 1e3, atol=1e-9)
    zero = np.median(a[: int(np.argmax(a[:, 1] > 0)) + 1, 2])
    np.testing.assert_allclose(records[0]["elongation"].values, (zero - a[:, 2]) / 1e3, atol=1e-12)
    np.testing.assert_allclose(
        records[0]["wire.voltage"].values, 12.0 * np.sqrt(a[:, 1] / 100), rtol=1e-6
    )
    assert [len(r["wire.voltage"]) for r in records] == [12000, 12000, 2400, 6000, 12000]
    assert [len(r["elongation"]) for r in records] == [12000, 12000, 12000, 6000, 12000]
    for record in records:  # one bench: the same stroke, rest and drive
        assert record.duration == pytest.approx(240, abs=0.1)
        assert record["elongation"].values.min() == pytest.approx(-0.0155, abs=1e-4)
        assert abs(record["elongation"].values[0]) < 2e-5
        assert 4.4 < record["wire.voltage"].values.max() < 4.7
        assert list(check_response(record)) == []
    for command, response in itertools.permutations(records, 2):
        swapped = {**command.signals, "elongation": response["elongation"]}
        (told,) = check_response(replace(command, signals=swapped))
        assert "stored runs or channels swapped" in told.text
    assert records[1]["ambient.temperature"].values[0] == pytest.approx(297.75)


def test_a_bag_says_where_it_comes_from(tmp_path, rig):
    source = write_csv(tmp_path)
    assert main(["import", str(source), "--params", str(rig), "--out", str(tmp_path / "bag"),
                 "--json", str(tmp_path / "r.json")]) == 0  # fmt: skip
    result = json.loads((tmp_path / "r.json").read_text())["imported"][0]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    custom = metadata["rosbag2_bagfile_information"]["custom_data"]
    assert json.loads(custom["sma_bench_provenance"])["sha256"] == result["sha256"]
    told = " ".join(f["text"] for f in describe(open_record(tmp_path / "bag"))["findings"])
    assert result["sha256"] in told and "sqrt(duty) x 12 V" in told


def test_the_written_map_gives_the_same_bag_again_and_for_several_files(tmp_path, rig):
    first = write_csv(tmp_path)
    second = tmp_path / "b day.csv"
    second.write_bytes(first.read_bytes())
    imported(first, rig, tmp_path / "bag")
    words = ["--map", str(tmp_path / "bag.map.yaml"), "--out", str(tmp_path / "week")]
    assert main(["import", str(first), str(second), *words]) == 0
    for name in ("a", "b_day"):
        again, once = read_record(tmp_path / "week" / name), read_record(tmp_path / "bag")
        for signal in once.signals.values():
            np.testing.assert_array_equal(again[signal.name].values, signal.values)


@pytest.mark.parametrize(
    ("titles", "scale", "said"),
    [
        (["time [s]", "duty [%]", "position"], (1, 100, 77), "no unit is given"),
        (["time", "duty [%]", "position [mm]"], (1000, 100, 1e3), "which unit"),
        (["time [s]", "voltage [V]", "position [mm]"], (1, 1.0, 1e3), "rms or mean"),
        (["time [s]", "supply [V]", "position [mm]"], (1, 1.0, 1e3), "no voltage, duty"),
        (["time [s]", "duty [%]", "wire temperature [K]"], (1, 100, 2e3), "beyond belief"),
    ],
)
def test_what_is_unsure_is_asked_in_one_line_and_in_the_map(
    titles, scale, said, tmp_path, rig, capsys
):
    columns = [c * s for c, s in zip((TIME, DUTY, PLACE), scale, strict=True)]
    source = text_file(tmp_path / "odd.csv", titles, columns)
    out = tmp_path / "bag"
    assert main(["import", str(source), "--params", str(rig), "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and said in line and "bag.map.yaml" in line
    assert not out.exists() and "ASK" in (tmp_path / "bag.map.yaml").read_text()


def test_a_filled_in_map_imports(tmp_path, rig, capsys):
    source = text_file(tmp_path / "odd.csv", ["time [s]", "duty [%]", "position"],
                       [TIME, DUTY * 100, PLACE * 77e3])  # fmt: skip
    bag, asked = tmp_path / "bag", tmp_path / "bag.map.yaml"
    assert main(["import", str(source), "--params", str(rig), "--out", str(bag)]) == 2
    with pytest.raises(InputError, match="unit is 'ask'"):
        read_map(asked)
    document = yaml.safe_load(asked.read_text().replace('unit: "ask"', 'unit: "mm"'))
    for entry in document["signals"]:
        entry["scale"] = 1 / 77 if entry["signal"] == "elongation" else 1.0
    asked.write_text(yaml.safe_dump(document))
    record = imported(source, rig, bag, "--map", str(asked))
    np.testing.assert_allclose(record["elongation"].values, MOVED, atol=1e-8)


def test_no_output_replaces_anything_and_no_input_ever(tmp_path, rig, capsys):
    source = write_csv(tmp_path)
    imported(source, rig, tmp_path / "bag")
    words = ["import", str(source), "--params", str(rig), "--out"]
    before = source.read_bytes()
    assert main([*words, str(tmp_path / "bag")]) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "bag"), "--force"]) == 0
    assert main([*words, str(source), "--force"]) == 2
    assert main([*words, str(tmp_path), "--force"]) == 2
    assert source.read_bytes() == before
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_a_wrong_file_among_several_leaves_no_bag(tmp_path, rig):
    good, bad = write_csv(tmp_path), tmp_path / "bad.csv"
    bad.write_text("time [s],duty [%],position [mm]\n0,0,1\n1,x,2\n2,0,3\n")
    words = ["--params", str(rig), "--out", str(tmp_path / "week")]
    assert main(["import", str(good), str(bad), *words]) == 2
    assert not (tmp_path / "week").exists()


def test_other_commands_say_how_a_table_becomes_a_record(tmp_path, capsys):
    for write in (write_csv, write_excel, write_hdf5):
        source = write(tmp_path)
        assert main(["identify", str(source)]) == 2
        assert f"sma-bench import {source.name} --out" in capsys.readouterr().err


def test_a_frame_of_elongation_and_force_needs_no_drive():
    pull = np.interp(TIME, [0, 10, 20, 30], [0, 6e-3, 0, 0])
    table = {"elongation": pull, "force": pull * 9e3}
    record = load({"time": TIME, **table})
    assert record["force"].values.max() == pytest.approx(54)


def test_tensile_pulls_angles_and_currents_are_read(tmp_path):
    pull = np.interp(TIME, [0, 10, 20, 30], [0, 6, 0, 0])
    source = text_file(tmp_path / "t.csv", ["t (s)", "elongation (mm)", "force (N)"],
                       [TIME, pull, -9 * pull])  # fmt: skip
    table = read_table_file(source)
    made, questions, _ = propose(table, BenchHints())
    signals = {s.name: s for s in convert(table, made)[0]}
    assert not questions
    np.testing.assert_allclose(signals["elongation"].values, pull / 1e3, atol=1e-12)
    np.testing.assert_allclose(signals["force"].values, 9 * pull, atol=1e-9)
    source = text_file(tmp_path / "w.csv", ["t (s)", "strom (mA)", "winkel (grad)"],
                       [TIME, 800.0 * (DUTY > 0), MOVED * 4e3])  # fmt: skip
    table = read_table_file(source)
    assert propose(table, BenchHints())[1] == [
        "'lever': m of movement for a radian? load.lever of --params says it"
    ]
    made, questions, _ = propose(table, BenchHints(lever=0.02))
    signals = {s.name: s for s in convert(table, made)[0]}
    assert not questions and signals["wire.current"].values.max() == pytest.approx(0.8)
    np.testing.assert_allclose(
        signals["elongation"].values, -np.radians(MOVED * 4e3) * 0.02, atol=1e-12
    )


def test_the_rig_that_turns_an_angle_into_movement_serves_other_commands_too(tmp_path, rig):
    rig.write_text(RIG.replace("preload: 6.0", "preload: 6.0, lever: 0.02"))
    source = text_file(tmp_path / "w.csv", ["t (s)", "duty (%)", "angle (deg)"],
                       [TIME, 100.0 * DUTY, MOVED * 4e3])  # fmt: skip
    bag = tmp_path / "bag"
    assert main(["import", str(source), "--params", str(rig), "--out", str(bag)]) == 0
    moved = read_record(bag)["elongation"].values.min()
    assert moved == pytest.approx(-np.radians(MOVED.max() * 4e3) * 0.02)
    assert main(["simulate", "--input", str(bag), "--params", str(rig),
                 "--out", str(tmp_path / "model")]) == 0  # fmt: skip


@settings(max_examples=25)
@given(
    separator=st.sampled_from([",", ";", "\t"]), decimal=st.sampled_from([".", ","]),
    millis=st.booleans(), unit=st.sampled_from(["mm", "um", "m", "cm"]),
    form=st.sampled_from(["{} [{}]", "{} ({})", "{}/{}", "{}_{}", "rows"]),
    above=st.lists(st.sampled_from(["Logger 7", "", "run: 3", "2026-10-02"]), max_size=3),
    sign=st.sampled_from([1, -1]), zero=st.floats(-0.05, 0.05),
)  # fmt: skip
def test_variants_of_a_text_come_back_as_they_went(
    tmp_path_factory, separator, decimal, millis, unit, form, above, sign, zero
):
    if separator == decimal:
        return
    scale = {"mm": 1e3, "um": 1e6, "m": 1.0, "cm": 1e2}[unit]
    units = ["ms" if millis else "s", "%", unit]
    names = ["time", "duty", "position"]
    titles = [form.format(n, u) for n, u in zip(names, units, strict=True)]
    if form == "rows":
        above, titles = [*above, separator.join(names)], units
    path = tmp_path_factory.mktemp("v") / "v.csv"
    columns = [TIME * (1e3 if millis else 1), DUTY * 100, (zero + sign * MOVED) * scale]
    text_file(path, titles, columns, separator, decimal, above, digits=15)
    table = read_table_file(path)
    made, questions, _ = propose(table, BenchHints(supply_voltage=SUPPLY, wire_length=0.38))
    assert not questions
    signals = {s.name: s for s in convert(table, made)[0]}
    np.testing.assert_allclose(signals["elongation"].time, TIME, atol=1e-9)
    np.testing.assert_allclose(signals["elongation"].values, -MOVED, atol=1e-11)
    np.testing.assert_allclose(signals["wire.voltage"].values, np.sqrt(DUTY) * SUPPLY, rtol=1e-12)


@settings(max_examples=60)
@given(st.binary(max_size=400), st.sampled_from(
    [b"", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0 MAT-file" + b" " * 107 + b"\0\1IM",
     b"PAR1", b"t,u\n"]
))  # fmt: skip
def test_any_bytes_are_a_table_or_one_line(tmp_path_factory, content, magic):
    path = tmp_path_factory.mktemp("h") / "x.bin"
    path.write_bytes(magic + content)
    try:
        assert read_table_file(path).columns
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)


def test_tables_that_unfold_without_end_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(border, "_BYTES", 1 << 20)
    bomb = tmp_path / "bomb.xlsx"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sheet.xml", bytes(2 << 20))
    claimed = tmp_path / "claims.h5"
    with h5py.File(claimed, "w") as file:
        file.create_dataset("t", shape=(1 << 40,), chunks=(1 << 16,), dtype="f8")
    outside = tmp_path / "outside.h5"
    (tmp_path / "secret").write_bytes(bytes(800))
    with h5py.File(outside, "w") as file:
        file.create_dataset("t", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
    io.savemat(tmp_path / "bomb.mat", {"x": np.zeros(1 << 18)}, do_compression=True)
    for path, said in ((bomb, "unfolds to more"), (tmp_path / "bomb.mat", "unfolds to more"),
                       (claimed, "unfolds to more"),
                       (outside, "another file")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_table_file(path)


@pytest.mark.parametrize("kind", [0, 8, 10, 14, 15, 19, 255])
@pytest.mark.parametrize("packed", [False, True])
def test_numbers_of_a_type_that_matlab_has_not_are_refused_before_they_end_the_process(
    kind, packed, tmp_path
):
    plain = tmp_path / "plain.mat"
    io.savemat(plain, {"t": np.arange(40) / 7.0, "s": {"u": np.arange(40) * 1.5}})
    content = plain.read_bytes()
    doubles = (9).to_bytes(4, "little") + (320).to_bytes(4, "little")
    assert content.count(doubles) == 2
    content = content.replace(doubles, kind.to_bytes(4, "little") + doubles[4:])
    if packed:
        elements = zlib.compress(content[128:])
        size = len(elements).to_bytes(4, "little")
        content = content[:128] + b"\x0f\0\0\0" + size + elements
    (tmp_path / "odd.mat").write_bytes(content)
    with pytest.raises(InputError, match="not a readable MATLAB file"):
        read_table_file(tmp_path / "odd.mat")
    assert len(read_table_file(plain).columns) == 2


@pytest.mark.parametrize("altered", [(8, 0x0806), (8, 0x0805), (8, 0x0005), (0, 0x00040006)])
def test_a_matlab_variable_that_promises_more_than_it_holds_is_refused(altered, tmp_path):
    """Scipy's compiled reader goes on into the next variable and ends the process there."""
    plain = tmp_path / "plain.mat"
    io.savemat(plain, {"t": np.arange(40) / 7.0, "u": np.arange(40) * 1.5})
    content = bytearray(plain.read_bytes())
    place, word = altered
    content[136 + place : 140 + place] = word.to_bytes(4, "little")
    (tmp_path / "odd.mat").write_bytes(content)
    if place:
        with pytest.raises(InputError, match="parts of a variable, expected"):
            read_table_file(tmp_path / "odd.mat")
    else:  # the tag of the flags is nobody's business
        assert len(read_table_file(tmp_path / "odd.mat").columns) == 2
    complex_ = tmp_path / "complex.mat"
    io.savemat(complex_, {"t": np.arange(40) / 7.0, "z": np.arange(40) * (1.0 + 1.0j)})
    assert [column.name for column in read_table_file(complex_).columns][0] == "t"


def test_a_matlab_file_of_countless_tiny_elements_is_refused_within_its_time(
    tmp_path, monkeypatch
):
    """They are looked at one by one, never held: 8 MB of empty elements were lists of 250 MB."""
    plain = tmp_path / "plain.mat"
    io.savemat(plain, {"t": np.arange(40) / 7.0})
    header = plain.read_bytes()[:128]
    empty = (9).to_bytes(8, "little") * MEGABYTE
    matrix = (14).to_bytes(4, "little") + len(empty).to_bytes(4, "little") + empty
    packed = zlib.compress(matrix)
    many = tmp_path / "many.mat"
    many.write_bytes(header + b"\x0f\0\0\0" + len(packed).to_bytes(4, "little") + packed)
    budget = Budget(64 * MEGABYTE, 0.1)
    tracemalloc.start()
    with pytest.raises(border.OverBudget, match="takes more than 0.1 s to read"):
        arrays_in_files._measure_matlab(many.read_bytes(), budget)
    assert tracemalloc.get_traced_memory()[1] < 40 * MEGABYTE
    tracemalloc.stop()


def test_a_clamped_wire_needs_no_position(tmp_path, rig):
    source = text_file(tmp_path / "heated.csv", ["time [s]", "duty [%]", "temperature [degC]"],
                       [TIME, DUTY * 100, 23.0 + 400.0 * DUTY])  # fmt: skip
    signals = imported(source, rig, tmp_path / "bag").signals
    assert set(signals) == {"wire.voltage", "wire.temperature"}


def test_texts_of_a_spreadsheet_without_end_take_no_longer_than_its_budget(tmp_path, monkeypatch):
    used = read_table_file.__globals__
    monkeypatch.setitem(used, "reading_budget", lambda size: used["Budget"](1 << 30, 0.03))
    good = write_excel(tmp_path)
    bomb = tmp_path / "texts.xlsx"
    texts = "<si><t>x</t></si>" * 200_000
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    part = f'<Override PartName="/xl/sharedStrings.xml" ContentType="{kind}"/></Types>'
    with zipfile.ZipFile(good) as before, zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as after:
        for name in before.namelist():
            content = before.read(name)
            if name == "[Content_Types].xml":
                content = content.replace(b"</Types>", part.encode())
            after.writestr(name, content)
        after.writestr("xl/sharedStrings.xml", f'<sst xmlns="{main}">{texts}</sst>')
    read_table_file(good)
    with pytest.raises(InputError, match="takes more than 0.03"):
        read_table_file(bomb)


def test_moments_beyond_all_measure_and_names_that_are_no_text_are_one_line(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    moments = pyarrow.array([-(2**40)] * 9, pyarrow.timestamp("s"))
    parquet.write_table(pyarrow.table({"t": moments}), tmp_path / "early.parquet")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_table_file(tmp_path / "early.parquet")
    with h5py.File(tmp_path / "names.h5", "w") as file:
        for name in ("t", "u"):
            file.create_dataset(name, data=np.arange(9.0)).attrs["unit"] = np.bytes_(b"\xff")
    with pytest.raises(InputError, match="sma-bench import"):
        open_record(tmp_path / "names.h5")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time [s],duty [%],x [mm]\n0,0,1\n1,1,2\n0.5,1,2\n", "goes back"),
        ("time [s],duty [%],x [mm]\n0,0,1\n1,bad,2\n2,1,2\n", "line 3"),
        ("a,b\n1,2\n3,4\n", "no position"),
        ("nothing\n", "no columns"),
    ],
)
def test_a_broken_table_is_one_line_that_says_where(text, said, tmp_path, capsys):
    (tmp_path / "x.csv").write_text(text)
    (tmp_path / "rig.yaml").write_text(RIG)
    words = ["--params", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "bag")]
    assert main(["import", str(tmp_path / "x.csv"), *words]) == 2
    line = capsys.readouterr().err
    assert said in line and line.count("\n") == 1
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("text", "quantity", "one"),
    [("degC", "temperature", 274.15), ("°F", "temperature", 255.928), ("mV", "voltage", 1e-3),
     ("V_rms", "voltage", 1.0), ("%", "ratio", 0.01), ("kgf", "force", 9.80665),
     ("µm", "length", 1e-6), ("N/mm²", "stress", 1e6), ("lbf", "force", 4.448222)],
)  # fmt: skip
def test_units_of_loggers_are_known(text, quantity, one):
    unit = parse_unit(text)
    assert unit is not None and unit.quantity == quantity
    assert unit.factor + unit.offset == pytest.approx(one, rel=1e-5)


def test_what_is_no_unit_is_none_and_nothing_is_evaluated():
    assert [parse_unit(t) for t in ("9**9**9", "slider", "__import__('os')", "", "x" * 99)] == (
        [None] * 5
    )
    assert split_title("slider_m") == ("slider", "m") and split_title("my_duty") == ("my_duty", "")


def test_kelvin_that_are_celsius_do_not_pass(tmp_path, rig):
    with pytest.raises(InputError, match="expected kelvin"):
        load({"time": TIME, "wire.temperature": np.linspace(23, 47, len(TIME))})
    table = read_table_file(text_file(
        tmp_path / "k.csv", ["time [s]", "duty [%]", "position [mm]", "wire temp [K]"],
        [TIME, DUTY * 100, PLACE * 1e3, np.linspace(23, 47, len(TIME))],
    ))  # fmt: skip
    questions = propose(table, BenchHints(supply_voltage=12.0))[1]
    assert len(questions) == 1 and "beyond belief, or in degC" in questions[0]


def rows_of_isobaric():
    half = np.linspace(25, 110, 80)
    heat = np.concatenate([half, half[::-1]])
    strain = 0.04 / (1 + np.exp((heat - np.repeat([75, 55], 80)) / 4))
    return heat, strain, np.full(160, 100.0)


def test_an_instruments_excel_and_matlab_files_are_read_as_its_text(tmp_path):
    heat, strain, stress = rows_of_isobaric()
    titles = ["Temperature (C)", "Strain (mm/mm)", "Stress (MPa)"]
    text_file(tmp_path / "i.csv", titles, [heat, strain, stress], digits=17)
    book = openpyxl.Workbook()
    for row in (titles, *np.column_stack([heat, strain, stress]).tolist()):
        book.active.append(row)
    book.save(tmp_path / "i.xlsx")
    io.savemat(tmp_path / "i.mat", {"temperature_C": heat, "strain": strain, "stress_MPa": stress})
    text = read_isobaric(tmp_path / "i.csv")
    for name in ("i.xlsx", "i.mat"):
        record = open_record(tmp_path / name)
        assert record.stress == pytest.approx(text.stress)
        assert len(record.cycles) == len(text.cycles)
        np.testing.assert_allclose(
            record.cycles[0].branches[0].strain, text.cycles[0].branches[0].strain
        )


def test_titles_without_units_are_taken_with_a_stated_guess(tmp_path):
    heat, strain, stress = rows_of_isobaric()
    source = text_file(tmp_path / "i.csv", ["Temperature", "Strain", "Stress"],
                       [heat, strain, stress])  # fmt: skip
    record = open_record(source)
    assert record.stress == pytest.approx(100e6)
    assert any("taken as MPa" in finding.text for finding in record.findings)
    pulled = np.linspace(0, 6, 60)
    source = text_file(tmp_path / "t.csv", ["Strain", "Stress"], [pulled, 80 * pulled])
    record = read_tensile(source)
    assert record.strain.max() == pytest.approx(0.06)
    assert record.stress.max() == pytest.approx(480e6)


@pytest.mark.parametrize(
    ("titles", "said"),
    [(["Temperature (C)", "Strain (%)"], "no stress column"),
     (["Strain (%)", "time (s)"], "no stress column"),
     (["Stress (MPa)", "time (s)"], "no strain column")],
)  # fmt: skip
def test_a_near_miss_says_what_is_missing(titles, said, tmp_path):
    source = text_file(tmp_path / "n.csv", titles, rows_of_isobaric()[:2])
    with pytest.raises(InputError, match=said):
        open_record(source)


def test_a_dsc_table_with_titles_is_a_dsc_run(tmp_path):
    time = np.arange(0, 3600, 2.0)
    kelvin = np.interp(time, [0, 1800, 3600], [0, 100, 0])
    rising = time < 1800
    flow = np.where(rising, 0.2, -0.2) + np.where(
        rising, 2, -2) * np.exp(-(((kelvin - np.where(rising, 70, 50)) / 4) ** 2))
    source = text_file(tmp_path / "d.csv", ["Time (s)", "Temperature (C)", "Heat Flow (W/g)"],
                       [time, kelvin, flow])  # fmt: skip
    record = open_record(source)
    assert [s.kind for s in record.segments if s.kind != "isothermal"] == ["heating", "cooling"]
    assert "no sample mass" in record.findings[0].text


def test_the_file_that_parameters_writes_is_a_rig_whose_zero_length_says_nothing(tmp_path):
    lab = tmp_path / "lab.yaml"
    assert main(["parameters", "--out", str(lab)]) == 0
    assert bench_of(read_parameter_names(lab), "lab.yaml").wire_length is None
    with pytest.raises(InputError, match="wire.length is -1, expected a number, 0 or more"):
        bench_of({"wire.length": -1}, "lab.yaml")

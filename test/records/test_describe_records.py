"""sma-bench info: everything about a record, for people and as JSON."""

import json

import numpy as np
import pytest

from sma_bench.commands import info
from sma_bench.commands.options import run_command
from sma_bench.errors import InputError
from sma_bench.records import DscRecord, Record, describe, open_record, read_record


def run_info(*arguments):
    return run_command(info.run, "sma-bench info", list(map(str, arguments)))


def test_description_is_plain_data_with_the_figures(tmp_path, write_bag, ramp):
    description = describe(read_record(write_bag(tmp_path / "bag", ramp)))
    json.dumps(description, allow_nan=False)
    assert description["start"] == "2023-11-14T22:13:20+00:00"
    assert description["channels"] == ["wire"]
    signals = {signal["name"]: signal for signal in description["signals"]}
    temperature = signals["wire.temperature"]
    assert temperature["rate"] == pytest.approx(100)
    assert temperature["delay"] == pytest.approx(0.003)
    assert (temperature["min"], temperature["max"]) == pytest.approx((293.15, 313.05))
    assert temperature["samples"] == 200 and temperature["jitter"] == pytest.approx(0, abs=1e-8)
    assert description["topics"][0] == {
        "name": "/bench/wire/power",
        "type": "sensor_msgs/msg/BatteryState",
        "count": 200,
        "signals": ["wire.voltage", "wire.current"],
    }


def test_info_shows_topics_signals_markers_and_findings(
    tmp_path, write_bag, ramp, messages, capsys
):
    marker = ("/bench/experiment/marker", messages.text("step [3] up"), messages.start)
    bag = write_bag(tmp_path / "bag", [*ramp, marker])
    out = tmp_path / "info.json"
    assert run_info(bag, "--json", out) == 0
    shown = capsys.readouterr().out
    for text in ("/bench/wire/power", "wire.temperature", "step [3] up", "no mechanical signal"):
        assert text in shown
    assert json.loads(out.read_text())["markers"] == [{"time": 0.0, "text": "step [3] up"}]


def test_info_of_a_bag_without_signals(tmp_path, write_bag, messages, capsys):
    bag = write_bag(tmp_path / "bag", [("/chatter", messages.text("hello"), messages.start)])
    with pytest.raises(InputError, match="nothing of a bench in it, expected topics"):
        run_info(bag)
    assert "no signal of the bench contract" in capsys.readouterr().out


def test_info_of_an_instrument_file(measured_data, capsys):
    assert run_info(measured_data / "sma_react/input/preprocessor_samples/DSC.txt") == 0
    shown = capsys.readouterr().out
    assert "60.200 mg" in shown and "cooling" in shown and "no findings" in shown


def test_records_are_told_apart_by_content(tmp_path, write_bag, ramp, measured_data):
    bag = write_bag(tmp_path / "bag", ramp)
    renamed = tmp_path / "bag.dat"
    next(bag.glob("*.mcap")).rename(renamed)
    assert isinstance(open_record(renamed), Record)
    dsc = tmp_path / "thing"
    source = measured_data / "sma_react/input/preprocessor_samples/DSC.txt"
    dsc.write_bytes(source.read_bytes())
    assert isinstance(open_record(dsc), DscRecord)


def test_other_files_are_refused_in_one_line(tmp_path):
    other = tmp_path / "notes.csv"
    other.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="sma-bench import|two columns"):
        open_record(other)
    with pytest.raises(InputError, match="no such file or folder"):
        open_record(tmp_path / "absent")


def test_description_survives_an_empty_signal(tmp_path):
    from sma_bench.records import Signal

    nothing = Signal("force", "N", np.zeros(0), np.zeros(0))
    json.dumps(describe(Record(tmp_path, 0, {"force": nothing})), allow_nan=False)

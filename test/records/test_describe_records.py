"""sma-bench info: everything about a record, as text and as JSON."""

import json

import numpy as np
import pytest

from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.records import Record, Signal, describe, open_record, read_record


def test_info_shows_everything_and_writes_json(tmp_path, write_bag, ramp, messages, capsys):
    marker = ("/bench/experiment/marker", messages.text("step [3] up"), messages.start)
    bag, out = write_bag(tmp_path / "bag", [*ramp, marker]), tmp_path / "info.json"
    assert main(["info", str(bag), "--json", str(out)]) == 0
    shown = capsys.readouterr().out
    for text in ("/bench/wire/power", "wire.temperature", "step [3] up", "no mechanical signal"):
        assert text in shown
    description = json.loads(out.read_text())
    assert description == json.loads(json.dumps(describe(read_record(bag)), allow_nan=False))
    assert description["markers"] == [{"time": 0.0, "text": "step [3] up"}]
    assert description["start"] == "2023-11-14T22:13:20+00:00"
    assert description["channels"] == ["wire"]
    signals = {signal["name"]: signal for signal in description["signals"]}
    temperature = signals["wire.temperature"]
    expected = {"rate": 100, "delay": 0.003, "min": 293.15, "max": 313.05, "jitter": 0}
    assert {n: temperature[n] for n in expected} == pytest.approx(expected, abs=1e-8)
    assert temperature["samples"] == 200
    power = {"name": "/bench/wire/power", "type": "sensor_msgs/msg/BatteryState", "count": 200,
             "signals": ["wire.voltage", "wire.current"]}
    assert power in description["topics"]
    nothing = Signal("force", "N", np.zeros(0), np.zeros(0))
    json.dumps(describe(Record(tmp_path, 0, {"force": nothing})), allow_nan=False)


def test_a_bag_of_another_robot_is_shown_and_refused(tmp_path, write_bag, messages, capsys):
    bag = write_bag(tmp_path / "bag", [("/chatter", messages.text("hello"), messages.start)])
    record = read_record(bag)
    assert record.signals == {} and record.duration == 0
    with pytest.raises(InputError, match="wire.voltage"):
        record["wire.voltage"]
    assert main(["info", str(bag)]) == 2
    shown = capsys.readouterr()
    assert "holds no topic of a bench, expected those" in shown.err
    assert "no signal of the bench contract" in shown.out and "/chatter" in shown.out


def test_the_kind_of_a_record_is_known_by_content(tmp_path, write_bag, ramp, measured_data, capsys):
    bag, renamed = write_bag(tmp_path / "bag", ramp), tmp_path / "bag.dat"
    next(bag.glob("*.mcap")).rename(renamed)
    assert isinstance(open_record(renamed), Record)
    dsc = measured_data / "sma_react/input/preprocessor_samples/DSC.txt"
    assert main(["info", str(dsc)]) == 0
    shown = capsys.readouterr().out
    assert "60.200 mg" in shown and "cooling" in shown and "no findings" in shown
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    others = {"notes.csv": "sma-bench import|2 columns", "absent": "no such file or folder"}
    for name, said in others.items():
        with pytest.raises(InputError, match=said):
            open_record(tmp_path / name)

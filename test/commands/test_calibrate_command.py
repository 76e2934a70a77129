"""sma-bench calibrate: from known loads to a parameter file that the bridge loads."""

import io
import json
import time

import numpy as np
import pytest
from uno.emulated_bench import on_a_port

from sma_bench.cli import main
from sma_bench.hardware.bench_sensors import Calibration
from sma_bench.parameters.yaml_file import read_parameter_names


def test_the_residual_error_of_a_calibration_becomes_a_stated_uncertainty(tmp_path, capsys):
    out = tmp_path / "lab.yaml"
    name = "uncertainty.sensor.current.gain"

    def calibrated(sensor, scatter, *more):
        loads = {"0.0": 0.0, "1.0": scatter, "2.0": -scatter, "3.0": 0.0}
        pairs = [f"{float(known) + off:.3f}={known}" for known, off in loads.items()]
        assert main(["calibrate", sensor, *pairs, "--out", str(out), *more]) == 0
        return read_parameter_names(out)[name]

    gain, answer = "calibration.front_current.gain", tmp_path / "fit.json"
    first = calibrated("front_current", 0.004, "--json", str(answer))
    assert "4 pairs from 0 to 3 A" in capsys.readouterr().out
    assert read_parameter_names(out)[gain] == pytest.approx(1.0, abs=0.005)
    assert 0.0 < json.loads(answer.read_text())["std"][gain] < 0.02
    assert first == pytest.approx(0.0035 / np.sqrt(5.0), rel=0.3)
    # Both boards share one uncertainty: the larger one counts.
    assert calibrated("back_current", 0.012) == pytest.approx(3.0 * first, rel=0.05)
    # Readings exactly on a line: the uncertainty is that of their last digits.
    pairs = ["5.91=6.00", "8.87=9.01", "11.83=12.02"]
    assert main(["calibrate", "supply", *pairs, "--out", str(out)]) == 0
    assert 5e-4 < read_parameter_names(out)["uncertainty.sensor.voltage.gain"] < 2e-3
    # Two pairs give no scatter, so the stated uncertainty is kept.
    out.write_text(f"/**:\n  ros__parameters:\n    {name}: 0.002\n")
    assert main(["calibrate", "front_current", "0=0", "1=1", "2=2.01", "--out", str(out)]) == 2
    assert f"contains {name} already" in capsys.readouterr().err
    before, again = out.read_text(), ["calibrate", "supply", *pairs, "--out", str(out)]
    assert (main(again), main(again)) == (0, 2)
    assert "--force replaces it" in capsys.readouterr().err
    assert main([*again, "--force"]) == 0
    out.write_text(before)
    assert main(["calibrate", "supply", "5=5", "9=9.1", "--out", str(out)]) == 0
    assert "uncertainty.sensor.voltage.gain" not in read_parameter_names(out)


def test_a_range_sensor_is_fitted_from_a_csv_and_joins_what_the_file_has(tmp_path):
    out, table = tmp_path / "lab.yaml", tmp_path / "range.csv"
    out.write_text("/**:\n  ros__parameters:\n    wire: {resistance: 2.5}\n")
    sensor = Calibration(8.1, -0.2, 0.004)
    rows = [(1.0 / (d + 0.004) + 0.2, d) for d in (0.05, 0.1, 0.2)]
    table.write_text("volt,metre\n" + "".join(f"{v / 8.1},{d}\n" for v, d in rows))
    command = ["calibrate", "back_range", "--csv", str(table), "--shift", "0.004"]
    assert main([*command, "--out", str(out)]) == 0
    values = read_parameter_names(out)
    assert values["wire.resistance"] == 2.5
    found = [values[f"calibration.back_range.{key}"] for key in ("gain", "offset", "shift")]
    assert found == pytest.approx([sensor.gain, sensor.offset, sensor.shift], rel=1e-6)


def test_known_loads_are_read_from_the_device_one_after_the_other(uno, tmp_path, monkeypatch):
    """The supply is set as the prompt asks; the divider is off by 2 %."""
    out = tmp_path / "lab.yaml"
    loads = [8.0, 10.0, 12.0]
    uno.electrics.divider = 4.0 * 1.02
    waiting = iter(loads)

    class Person(io.StringIO):
        def readline(self, *_):
            bench.do(lambda: setattr(uno.electrics, "supply", next(waiting)))
            settled = uno.time + 0.2
            while uno.time < settled:
                time.sleep(0.01)
            return "\n"

    monkeypatch.setattr("sys.stdin", Person())
    with on_a_port(uno) as bench:
        known = ["--known", *map(str, loads)]
        command = ["calibrate", "supply", "--device", bench.path, *known, "--out", str(out)]
        assert main(command) == 0
    values = read_parameter_names(out)
    assert values["calibration.supply.gain"] == pytest.approx(1.02, abs=0.01)
    assert sum(uno.electrics.on_time) == 0.0

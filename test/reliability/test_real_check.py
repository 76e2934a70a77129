"""`./bench check real` on a folder in the layout of the public bench, played here (synthetic)."""

import numpy as np
import pytest
from scipy.io import savemat

from examination.check import real
from sma_bench.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("public") / real.BENCH["data"]
    folder.mkdir(parents=True)
    for k, name in enumerate(real.RUNS):
        time = np.arange(0.0, 50.0, 1e-3)
        duty = 0.2 * ((time > 10.0) & (time < 20.0 + k))
        moved = 0.016 * np.interp(time, [11.0, 14.0, 26.0 + k, 40.0 + k], [0.0, 1.0, 1.0, 0.0])
        _save(folder / f"SensorInput_{name}.mat", time, duty)
        _save(folder / f"SensorPosition_{name}.mat", time[::10], 0.001 + moved[::10])
    return folder.parent


def _save(path, time, values):
    savemat(path, {"own": {"time": time, "signals": {"values": values}, "blockName": ""}})


def test_a_run_begins_at_rest_and_has_the_heat_that_was_played(folder):
    run = real.run_of(folder, "Step02")
    assert run["elongation"].values[0] == pytest.approx(0.0, abs=1e-9)
    assert run["elongation"].values.min() == pytest.approx(-0.016, rel=1e-6)
    volts = np.interp([5.0, 15.0], run["wire.voltage"].time, run["wire.voltage"].values)
    assert volts == pytest.approx([0.0, 24.0 * np.sqrt(0.2)])
    weaker = real.run_of(folder, "Step05_SR")["wire.voltage"]  # its file holds another run's input
    assert np.interp(25.0, weaker.time, weaker.values) == pytest.approx(24.0 * np.sqrt(0.1))


def test_the_rival_learns_what_it_is_shown(folder):
    shown = [real.run_of(folder, name) for name in ("Step01", "Ramp02")]
    rival = real.fit_rival(shown)
    for run in shown:
        moved = real.motion(run)[1]
        assert np.std(real.eight_numbers(rival, run) - moved) < 0.08 * np.ptp(moved)


def test_what_is_not_there_is_said(tmp_path, capsys):
    assert real.main([str(tmp_path)]) == 0
    assert "skipped" in capsys.readouterr().out
    with pytest.raises(InputError, match="Step01"):
        real.run_of(tmp_path, "Step01")

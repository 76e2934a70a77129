"""`./bench check real` on a folder in the layout of the public bench, made here (synthetic)."""

import numpy as np
import pytest
from scipy.io import savemat

from examination.check import real
from sma_bench.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("public") / real.BENCH["data"]
    folder.mkdir(parents=True)
    time = np.arange(0.0, 50.0, 1e-3)
    for k, name in enumerate(real.RUNS):
        duty = 0.2 * ((time > 10.0) & (time < 20.0 + k))
        moved = np.interp(time, [11.0, 14.0, 26.0 + k, 40.0 + k], [0.001, 0.017, 0.017, 0.001])
        for kind, stamps, values in (("Input", time, duty), ("Position", time[::10], moved[::10])):
            held = {"time": stamps, "signals": {"values": values}}
            savemat(folder / f"Sensor{kind}_{name}.mat", {"own": held})
    return folder.parent


def test_a_run_is_read_as_it_was_played_and_the_rival_learns_it(folder, tmp_path, capsys):
    run, weaker = (real.run_of(folder, name) for name in ("Step02", "Step05_SR"))
    assert np.ptp(run["elongation"].values) == pytest.approx(0.016, rel=1e-6)
    assert run["elongation"].values.max() == pytest.approx(0.0, abs=1e-9)  # from rest
    for own, duty in ((run, 0.2), (weaker, 0.1)):  # the second file holds another run's input
        volts = np.interp([5.0, 15.0], own["wire.voltage"].time, own["wire.voltage"].values)
        assert volts == pytest.approx([0.0, 24.0 * np.sqrt(duty)])
    missed = real.eight_numbers(real.fit_rival([run]), run) - real.motion(run)[1]
    assert np.std(missed) < 0.08 * 0.016
    assert real.main([str(tmp_path)]) == 0 and "skipped" in capsys.readouterr().out
    with pytest.raises(InputError, match="Step01"):
        real.run_of(tmp_path, "Step01")

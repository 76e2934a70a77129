"""The naive rivals: each finds an effect that is easy, and each has the flaw it is known for."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from examination.blind.case_files import checked_answer
from examination.blind.rival_fitting import effect_knobs, fit, observe, whitened
from examination.blind.rivals import RIVALS, log_tail, rival_answer
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import effect_values
from sma_bench.physics.simulate import simulate
from sma_bench.records import Record, Signal

pytest.importorskip("numba", reason="whole records take minutes uncompiled")

NOISE = {"current": 0.008, "temperature": 0.25, "deflection": 4e-5}
RIG = Parameters({
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
    "wire.resistance": 3.05, "wire.heat_transfer_coefficient": 115.0, "wire.specific_heat": 415.0,
    "wire.surface_area": 188.5e-6, "wire.austenite_start_temperature": 334.0,
    "wire.austenite_finish_temperature": 353.0, "wire.martensite_start_temperature": 320.0,
    "wire.martensite_finish_temperature": 307.5, "wire.maximum_recoverable_strain": 0.0385,
    "composite.deflection_per_strain": 1.01, "composite.stress_per_deflection_front": 4.9e9,
    "composite.stress_per_deflection_back": 4.9e9, "environment.ambient_temperature": 293.5,
})  # fmt: skip


def lab_record(bench: Parameters, seed: int, peaks=(2.15, 2.05), rho=0.0, end=50.0) -> Record:
    """At 50 Hz: front, back, ... with rests; AR(1) noise of correlation rho."""
    time = np.arange(0.0, end, 0.02)
    side = np.clip(np.sin(2.0 * np.pi * time / 50.0) * 1.4 - 0.3, 0.0, 1.0)
    other = np.clip(-np.sin(2.0 * np.pi * time / 50.0) * 1.4 - 0.3, 0.0, 1.0)
    volts = np.column_stack([peaks[0] * side] * 2 + [peaks[1] * other] * 2)
    true = simulate(bench, time, volts)
    rng = np.random.default_rng(seed)

    def noisy(name: str, values: np.ndarray) -> Signal:
        quantity = name.rpartition(".")[2]
        noise = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(len(time)))
        return Signal(name, "", time, values + NOISE[quantity] * noise)

    signals = [noisy("deflection", true.deflection_reading)]
    for k, channel in enumerate(bench["bench.channels"]):
        signals += [
            Signal(f"{channel}.voltage", "V", time, volts[:, k]),
            noisy(f"{channel}.current", true.current[:, k]),
            noisy(f"{channel}.temperature", true.temperature_reading[:, k]),
        ]
    return Record(Path("made"), 0, {signal.name: signal for signal in signals})


@pytest.fixture(scope="module")
def coupled() -> tuple[Record, Record]:
    bench = RIG.replace(effect_values("side_heat_coupling", 2e-3))
    return lab_record(bench, 1, end=100.0), lab_record(bench, 2, peaks=(2.0, 2.1))


@pytest.mark.parametrize("name", RIVALS)
def test_rival_finds_an_easy_effect_and_how_far_the_gap_shrinks(name, coupled):
    record, hold_out = coupled
    document, improved = rival_answer(name, [record], [hold_out], RIG)
    answer = checked_answer(document)
    assert (answer.verdict, answer.cause) == ("effect", ("side_heat_coupling",))
    assert answer.where.stage == "thermal"
    assert improved["effect.side_heat_coupling.conductance"] == pytest.approx(2e-3, rel=0.1)
    claim = answer.shrinkage["temperature"]
    assert claim.fraction > 0.8
    assert claim.noise_floor == pytest.approx(0.25 / np.sqrt(5), rel=0.1)


@pytest.mark.parametrize("name", RIVALS)
def test_rival_is_quiet_when_nothing_is_wrong_and_the_noise_is_white(name):
    document, improved = rival_answer(name, [lab_record(RIG, 3)], [], RIG)
    assert checked_answer(document).verdict == "no_gap"
    assert improved["wire.resistance"] == RIG["wire.resistance"]


def test_score_test_raises_a_false_alarm_on_coloured_noise():
    document, _ = rival_answer("score", [lab_record(RIG, 4, rho=0.95)], [], RIG)
    assert checked_answer(document).verdict == "effect"


def test_only_the_joint_refit_knows_wrong_parameters_from_an_effect():
    wrong = RIG.replace({"wire.heat_transfer_coefficient": 105.0})
    verdicts = {}
    for name in RIVALS:
        document, _ = rival_answer(name, [lab_record(RIG, 5)], [], wrong)
        verdicts[name] = checked_answer(document).verdict
    assert verdicts == {"rmse": "effect", "score": "effect", "bic": "recalibration"}


def test_records_of_deflection_alone_are_enough(coupled):
    record, _ = coupled
    kept = {n: s for n, s in record.signals.items() if n.endswith(("voltage", "deflection"))}
    document, _ = rival_answer("score", [Record(record.path, 0, kept)], [], RIG)
    assert set(checked_answer(document).shrinkage) == {"deflection"}


def test_binned_residuals_of_the_truth_are_white_and_of_unit_variance():
    bench = RIG.replace(effect_values("latent_heat", 8e3))
    residual = whitened([observe(lab_record(bench, 6), bench)], bench)
    assert np.std(residual) == pytest.approx(1.0, abs=0.05)
    assert abs(np.corrcoef(residual[1:], residual[:-1])[0, 1]) < 0.1


def test_a_fit_never_leaves_the_range_of_its_parameters():
    observed = [observe(lab_record(RIG.replace({"wire.resistance": 2.6}), 7), RIG)]
    found = fit(observed, RIG, effect_knobs("supply_drop", RIG))
    assert found.parameters["effect.supply_drop.resistance"] >= 0.0


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_tail_of_chi_square_goes_on_where_numbers_end(k):
    assert log_tail(30.0, k) == pytest.approx(stats.chi2.logsf(30.0, k), rel=1e-9)
    # d ln Q / dx tends to -1/2
    assert log_tail(4000.0, k) - log_tail(2000.0, k) == pytest.approx(-1000.0, rel=2e-3)

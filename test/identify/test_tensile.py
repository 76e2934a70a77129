"""E7 on synthetic curves with known moduli."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.instruments.tensile import identify_tensile, read_curve
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal
from sma_bench.records.tensile import TensileRecord

E_M, E_A = 22.8e9, 55.4e9
# The wire's own transition temperatures, as E5 or E6 give them.
OWN = Parameters.of_paper().replace({
    "wire.martensite_finish_temperature": 325.09, "wire.austenite_finish_temperature": 353.61,
})
COLD, HOT = 293.15, 403.15


def loading(
    knots: list[tuple[float, float]], points: int, noise: float, seed: int, toe: float = 0.0,
    rounding: float = 0.0006,
) -> tuple[np.ndarray, np.ndarray]:
    """A smooth curve through knots (strain, stress) with slack before it and noisy force."""
    rng = np.random.default_rng(seed)
    strain = np.linspace(0.0, knots[-1][0] + toe, points)
    at = np.maximum(strain - toe, 0.0)
    fine = np.linspace(0.0, knots[-1][0], 20001)
    stress = np.interp(fine, *zip(*knots, strict=True))
    # Rounded corners, as real curves have.
    width = int(rounding / (fine[1] - fine[0]))
    padded = np.pad(stress, width, mode="reflect", reflect_type="odd")
    stress = np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    return strain, np.interp(at, fine, stress) + noise * rng.standard_normal(points)


def martensite(
    seed: int = 1, modulus: float = E_M, initial: float = E_M, noise: float = 0.5e6,
    toe: float = 0.002, detwin: float = 130e6, end: float = 0.06, points: int = 1500,
) -> TensileRecord:
    first = detwin / initial
    last = detwin + 0.6e9 * (0.04 - first)
    knots = [(0.0, 0.0), (first, detwin), (0.04, last), (end, last + modulus * (end - 0.04))]
    strain, stress = loading(knots, points, noise, seed, toe)
    return TensileRecord(Path(f"cold_{seed}.csv"), strain, stress, COLD)


def austenite(seed: int = 1, noise: float = 0.5e6, toe: float = 0.001) -> TensileRecord:
    plateau = 500e6
    knots = [(0.0, 0.0), (plateau / E_A, plateau), (0.06, plateau + 1e9 * (0.06 - plateau / E_A))]
    strain, stress = loading(knots, 1500, noise, seed, toe)
    return TensileRecord(Path(f"hot_{seed}.csv"), strain, stress, HOT)


def test_rounded_corners_and_yielding_leave_the_modulus() -> None:
    last = 130e6 + 0.6e9 * 0.034
    knots = [(0.0, 0.0), (0.006, 130e6), (0.04, last), (0.06, last + 0.02 * E_M),
             (0.08, last + 0.02 * E_M + 0.02 * 6e9)]
    strain, stress = loading(knots, 2000, 0.5e6, 3, toe=0.002, rounding=0.003)
    reading = read_curve(TensileRecord(Path("round.csv"), strain, stress, COLD))
    assert reading.after is not None
    assert reading.after.modulus == pytest.approx(E_M, rel=0.02)
    assert reading.after.strain[1] < 0.062


def test_moduli_of_table_three_come_back_with_repeats() -> None:
    records = [martensite(seed) for seed in range(3)] + [austenite(seed) for seed in range(3)]
    experiment = identify_tensile(records, OWN)
    e_m = experiment.estimates["wire.martensite_modulus"]
    e_a = experiment.estimates["wire.austenite_modulus"]
    assert e_m.value == pytest.approx(E_M, rel=0.01)
    assert e_a.value == pytest.approx(E_A, rel=0.01)
    assert 0.0 < e_m.statistical < 0.02 * E_M
    assert "mean of 3 tests" in e_m.method


def test_error_of_repeats_is_that_of_the_mean_of_so_few_specimens() -> None:
    moduli = [21.6e9, 22.8e9, 24.0e9]
    records = [martensite(seed, modulus=m, initial=m) for seed, m in enumerate(moduli)]
    estimate = identify_tensile(records, OWN).estimates["wire.martensite_modulus"]
    # 1.645 of it are as far as Student's t of two degrees of freedom goes in 90 %.
    mean = 1.2e9 / 3**0.5 * 2.920 / 1.645
    assert estimate.statistical == pytest.approx(mean, rel=0.05)


def test_slope_before_the_plateau_is_reported_where_it_differs() -> None:
    experiment = identify_tensile([martensite(initial=35e9)], OWN)
    assert experiment.estimates["wire.martensite_modulus"].value == pytest.approx(E_M, rel=0.02)
    before = experiment.details["E_M before the plateau"]
    assert before.value == pytest.approx(35e9, rel=0.05)
    assert any("before the detwinning plateau" in f.text for f in experiment.findings)


def test_plateau_stress_of_austenite_is_given() -> None:
    details = identify_tensile([austenite(s) for s in range(3)], OWN).details
    assert details["austenite plateau stress"].value == pytest.approx(525e6, rel=0.02)


def test_test_that_ends_on_the_plateau_says_so() -> None:
    record = martensite(end=0.0405)
    cut = record.strain < 0.03
    short = TensileRecord(record.path, record.strain[cut], record.stress[cut], COLD)
    experiment = identify_tensile([short], OWN)
    assert any("ends on the detwinning plateau" in f.text for f in experiment.findings)
    estimate = experiment.estimates["wire.martensite_modulus"]
    assert estimate.value == pytest.approx(E_M, rel=0.03)


def test_unloading_slope_is_measured() -> None:
    record = martensite()
    top, strain = record.stress.max(), record.strain[-1]
    down = np.linspace(0.0, top / 30e9, 300)
    both = TensileRecord(
        record.path, np.concatenate([record.strain, strain - down]),
        np.concatenate([record.stress, top - 30e9 * down]), COLD,
    )
    experiment = identify_tensile([both], OWN)
    assert experiment.details["E_M on unloading"].value == pytest.approx(30e9, rel=0.01)
    assert experiment.estimates["wire.martensite_modulus"].value == pytest.approx(E_M, rel=0.02)


@pytest.mark.parametrize("noise", [0.1e6, 3e6])
def test_intervals_cover_the_truth(noise: float) -> None:
    inside = []
    for seed in range(40):
        modulus = float(np.random.default_rng(seed).uniform(18e9, 35e9))
        record = martensite(seed + 100, modulus=modulus, initial=modulus, noise=noise, points=800)
        estimate = identify_tensile([record], OWN).estimates["wire.martensite_modulus"]
        inside.append(abs(estimate.value - modulus) < 1.96 * estimate.std)
        assert estimate.value == pytest.approx(modulus, rel=0.05)
    assert np.mean(inside) > 0.85


def test_phase_between_the_ranges_must_be_given() -> None:
    record = martensite()
    lukewarm = TensileRecord(record.path, record.strain, record.stress, 340.0)
    with pytest.raises(InputError, match="between M_f 325.1 K and A_f"):
        identify_tensile([lukewarm], OWN)
    experiment = identify_tensile([lukewarm], OWN, phases={record.path.name: "martensite"})
    assert "wire.martensite_modulus" in experiment.estimates


def test_phase_is_never_told_by_another_wires_temperatures() -> None:
    with pytest.raises(InputError, match=r"M_f and A_f of this wire are not known.*--phase cold_1"):
        identify_tensile([martensite()])
    found = identify_tensile([martensite(), austenite()], phases={"c*": "martensite",
                                                                  "hot_?.csv": "austenite"})
    assert found.estimates["wire.austenite_modulus"].value == pytest.approx(E_A, rel=0.01)


def test_phase_in_the_file_counts_and_what_is_asked_for_counts_more() -> None:
    record = replace(martensite(), phase="austenite", temperature=None)
    assert set(identify_tensile([record]).estimates) == {"wire.austenite_modulus"}
    told = identify_tensile([record], phases={"cold_1.csv": "martensite"})
    assert set(told.estimates) == {"wire.martensite_modulus"}


@pytest.mark.parametrize(("phases", "message"), [
    ({"cold_1.csv": "bainite"}, "'bainite', expected martensite or austenite"),
    ({"warm*": "martensite"}, r"phase of warm\*: no such tensile test among cold_1.csv"),
    ({"cold*": "martensite", "*.csv": "austenite"}, "said to be martensite and to be austenite"),
])
def test_phase_that_cannot_be_is_refused(phases, message) -> None:
    with pytest.raises(InputError, match=message):
        identify_tensile([martensite()], phases=phases)


def test_swapped_phases_are_noticed() -> None:
    swapped = {"cold*": "austenite", "hot*": "martensite"}
    experiment = identify_tensile([martensite(), austenite()], phases=swapped)
    assert any("phases of the tests swapped" in f.text for f in experiment.findings)


def test_repeats_that_show_different_slopes_are_not_pooled() -> None:
    whole, record = martensite(1, initial=35e9), martensite(2, initial=35e9)
    cut = record.strain < 0.03
    short = TensileRecord(record.path, record.strain[cut], record.stress[cut], COLD)
    experiment = identify_tensile([whole, short], OWN)
    estimate = experiment.estimates["wire.martensite_modulus"]
    assert estimate.value == pytest.approx(E_M, rel=0.02)
    assert "loading after detwinning" in estimate.method
    assert any("left out, as other tests show" in f.text for f in experiment.findings)


def test_absurd_modulus_is_remarked() -> None:
    record = austenite()
    soft = TensileRecord(record.path, record.strain, record.stress / 100.0, HOT)
    assert any("crosshead travel" in f.text for f in identify_tensile([soft], OWN).findings)


@pytest.mark.parametrize("room, asked", [(None, {"pull 1": "martensite"}), (293.15, {})])
def test_pulls_in_a_bag_need_neither_voltage_nor_the_wires_temperature(room, asked):
    time = np.arange(0.0, 120.0, 0.1)
    elongation = np.interp(time, [5.0, 65.0, 115.0], [0.0, 1.6e-3, 0.0])
    force = 22.8e9 * np.pi / 4.0 * 0.09e-6 * elongation / 0.2
    signals = [Signal("elongation", "m", time, elongation), Signal("force", "N", time, force)]
    if room:
        signals.append(Signal("ambient.temperature", "K", time, np.full(time.size, room)))
    record = Record(Path("frame"), 0, {signal.name: signal for signal in signals})
    wire = OWN.replace({"wire.length": 0.2, "wire.diameter": 0.3e-3})
    found = identify([record], wire, phases=asked).estimates["wire.martensite_modulus"]
    assert found.value == pytest.approx(22.8e9, rel=2e-3)
    heated = {**record.signals, "wire.voltage": Signal("wire.voltage", "V", time, 0.01 * time)}
    with pytest.raises(InputError, match="nothing to identify"):
        identify([Record(Path("heated"), 0, heated)], wire)
    if not room:
        with pytest.raises(InputError, match="give --phase pull 1=martensite"):
            identify([record], wire)

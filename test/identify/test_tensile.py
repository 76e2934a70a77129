"""E7 on synthetic curves with known moduli."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.tensile import identify_tensile
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal
from sma_bench.records.instruments import TensileRecord

E_M, E_A = 22.8e9, 55.4e9
# The wire's own transition temperatures, as E5 or E6 give them.
OWN = Parameters.of_paper().replace(
    {"wire.martensite_finish_temperature": 325.09, "wire.austenite_finish_temperature": 353.61}
)
MODULI = ("wire.martensite_modulus", "wire.austenite_modulus")


def pulled(path: str, kelvin: float, knots: list, seed: int, toe: float) -> TensileRecord:
    """A smooth curve through knots (strain, stress) with slack before it and noisy force."""
    strain = np.linspace(0.0, knots[-1][0] + toe, 1500)
    fine = np.linspace(0.0, knots[-1][0], 20001)
    stress = np.interp(fine, *zip(*knots, strict=True))
    # Rounded corners, as real curves have.
    padded = np.pad(stress, 200, mode="reflect", reflect_type="odd")
    stress = np.convolve(padded, np.ones(401) / 401, mode="valid")
    noise = 0.5e6 * np.random.default_rng(seed).standard_normal(1500)
    stress = np.interp(np.maximum(strain - toe, 0.0), fine, stress) + noise
    return TensileRecord(Path(f"{path}_{seed}.csv"), strain, stress, kelvin)


def martensite(seed: int = 1, modulus: float = E_M, initial: float = E_M) -> TensileRecord:
    first = 130e6 / initial
    last = 130e6 + 0.6e9 * (0.04 - first)
    knots = [(0.0, 0.0), (first, 130e6), (0.04, last), (0.06, last + modulus * 0.02)]
    return pulled("cold", 293.15, knots, seed, 0.002)


def austenite(seed: int = 1) -> TensileRecord:
    knots = [(0.0, 0.0), (500e6 / E_A, 500e6), (0.06, 500e6 + 1e9 * (0.06 - 500e6 / E_A))]
    return pulled("hot", 403.15, knots, seed, 0.001)


def test_moduli_of_table_three_come_back_with_repeats() -> None:
    records = [martensite(seed) for seed in range(3)] + [austenite(seed) for seed in range(3)]
    experiment = identify_tensile(records, OWN)
    e_m, e_a = (experiment.estimates[name] for name in MODULI)
    assert e_m.value == pytest.approx(E_M, rel=0.01)
    assert e_a.value == pytest.approx(E_A, rel=0.01)
    assert 0.0 < e_m.statistical < 0.02 * E_M
    assert "mean of 3 tests" in e_m.method
    assert experiment.details["austenite plateau stress"].value == pytest.approx(525e6, rel=0.02)
    swapped = {"cold*": "austenite", "hot*": "martensite"}
    findings = identify_tensile(records[:1] + records[3:4], OWN, phases=swapped).findings
    assert any("phases of the tests swapped" in f.text for f in findings)
    soft = replace(records[3], stress=records[3].stress / 100.0)
    assert any("crosshead travel" in f.text for f in identify_tensile([soft], OWN).findings)


def test_error_of_repeats_is_that_of_the_mean_of_so_few_specimens() -> None:
    moduli = [21.6e9, 22.8e9, 24.0e9]
    records = [martensite(seed, modulus=m, initial=m) for seed, m in enumerate(moduli)]
    estimate = identify_tensile(records, OWN).estimates[MODULI[0]]
    # 1.645 of it are as far as Student's t of two degrees of freedom goes in 90 %.
    mean = 1.2e9 / 3**0.5 * 2.920 / 1.645
    assert estimate.statistical == pytest.approx(mean, rel=0.05)


def test_a_phase_is_that_asked_for_or_of_the_file_or_of_this_wires_temperatures() -> None:
    record = martensite()
    in_file = replace(record, phase="austenite", temperature=None)
    assert set(identify_tensile([in_file]).estimates) == {MODULI[1]}
    told = identify_tensile([in_file], phases={"cold_1.csv": "martensite"})
    assert set(told.estimates) == {MODULI[0]}
    with pytest.raises(InputError, match="between M_f 325.1 K and A_f"):
        identify_tensile([replace(record, temperature=340.0)], OWN)
    with pytest.raises(InputError, match=r"M_f and A_f of this wire are not known.*--phase cold_1"):
        identify_tensile([record])
    patterns = {"c*": "martensite", "hot_?.csv": "austenite"}
    found = identify_tensile([record, austenite()], phases=patterns).estimates
    assert found[MODULI[1]].value == pytest.approx(E_A, rel=0.01)


@pytest.mark.parametrize(("phases", "message"), [
    ({"cold_1.csv": "bainite"}, "'bainite', expected martensite or austenite"),
    ({"warm*": "martensite"}, r"phase of warm\*: no such tensile test among cold_1.csv"),
    ({"cold*": "martensite", "*.csv": "austenite"}, "martensite and to be austenite"),
])  # fmt: skip
def test_phase_that_cannot_be_is_refused(phases, message) -> None:
    with pytest.raises(InputError, match=message):
        identify_tensile([martensite()], phases=phases)


def test_a_test_that_ends_on_the_plateau_says_so_and_is_not_pooled_with_whole_ones() -> None:
    whole, record = martensite(1, initial=35e9), martensite(2, initial=35e9)
    cut = record.strain < 0.03
    short = replace(record, strain=record.strain[cut], stress=record.stress[cut])
    alone, both = identify_tensile([short], OWN), identify_tensile([whole, short], OWN)
    assert any("ends on the detwinning plateau" in f.text for f in alone.findings)
    assert both.estimates[MODULI[0]].value == pytest.approx(E_M, rel=0.02)
    assert any("left out, as other tests show" in f.text for f in both.findings)


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
    found = identify([record], wire, phases=asked).estimates[MODULI[0]]
    assert found.value == pytest.approx(22.8e9, rel=2e-3)
    heated = {**record.signals, "wire.voltage": Signal("wire.voltage", "V", time, 0.01 * time)}
    with pytest.raises(InputError, match="nothing to identify"):
        identify([Record(Path("heated"), 0, heated)], wire)
    if not room:
        with pytest.raises(InputError, match="give --phase pull 1=martensite"):
            identify([record], wire)

"""Text exports of TA Instruments' DSCs: Universal Analysis and TRIOS."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.identify.instruments.transition_temperatures import identify_heating_rates
from sma_bench.records import read_dsc

MASS = 10.2  # mg
HEADER = f"""CLOSED
Version\t2.0
Instrument\tDSC Q2000 V24.11 Build 124
Module\tDSC Standard Cell RC
Sample\tNiTi wire
Size\t{MASS:.4f}\tmg
Exotherm\tDOWN
Nsig\t4
Sig1\tTime (min)
Sig2\tTemperature (°C)
Sig3\tHeat Flow (mW)
Sig4\tHeat Capacity (mJ/°C)
OrgMethod\t1: Equilibrate at 0.00 °C
OrgMethod\t2: Ramp 5.00 °C/min to 180.00 °C
OrgMethod\t3: Isothermal for 3.00 min
OrgMethod\t4: Ramp 5.00 °C/min to 0.00 °C
StartOfData
"""


def peak(t: np.ndarray, start: float, finish: float) -> np.ndarray:
    """Rounded trapezoid in W/g whose tangents meet the base at start and finish; degC."""
    knots = np.linspace(start, finish, 4)
    sharp = np.interp(t, knots, [0.0, 0.3, 0.3, 0.0])
    return np.convolve(np.pad(sharp, 20, mode="edge"), np.ones(41) / 41.0, mode="valid")


def run() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time min, degC, W/g (endothermic up) of heating, holding and cooling at 5 K/min."""
    step = 0.02
    up = np.arange(0.0, 180.0, 5.0 * step)
    hold = np.full(int(3.0 / step), 180.0)
    t = np.concatenate([up, hold, up[::-1]])
    flow = np.concatenate(
        [0.05 + peak(up, 70.0, 95.0), np.zeros(len(hold)), -0.05 - peak(up, 50.0, 80.0)[::-1]]
    )
    return np.arange(len(t)) * step, t, flow


def universal(
    path: Path, sign: float = 1.0, exotherm: str = "DOWN", encoding: str = "utf-8"
) -> Path:
    time, t, flow = run()
    rows = "\n".join(
        f"{a:.6f}\t{b:.5f}\t{sign * MASS * c:.6f}\t0.0"
        for a, b, c in zip(time, t, flow, strict=True)
    )
    path.write_text(HEADER.replace("DOWN", exotherm) + rows + "\n", encoding=encoding)
    return path


def trios(path: Path) -> Path:
    time, t, flow = run()
    n = int(np.argmax(t))
    text = f"Filename\tx\n[Procedure]\nSample Name\tNiTi\nSample Mass\t{MASS} mg\n"
    text += "[Configuration]\nInstrument Type\tDSC2500\nExotherm Direction\tDown\n"
    for title, part in (
        ("Ramp 5.00 °C/min to 180.00 °C", slice(0, n)),
        ("Ramp 5.00 °C/min to 0.00 °C", slice(len(t) - n, len(t))),
    ):
        text += f"[step]\n{title}\nTime\tTemperature\tHeat Flow (Normalized)\nmin\t°C\tW/g\n"
        text += "\n".join(
            f"{a:.2f}\t{b:.2f}\t{c:.4f}"
            for a, b, c in zip(time[part], t[part], flow[part], strict=True)
        ) + "\n\n"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_universal_analysis_is_cut_into_its_steps(tmp_path: Path, encoding: str) -> None:
    path = universal(tmp_path / "q2000.txt", encoding=encoding)
    record = read_dsc(path)
    assert [s.kind for s in record.segments] == ["heating", "isothermal", "cooling"]
    assert record.mass == pytest.approx(MASS * 1e-6)
    assert record.segments[0].rate == pytest.approx(5.0 / 60.0)
    assert record.segments[2].rate == pytest.approx(-5.0 / 60.0)
    assert record.endothermic_up is True
    assert "Q2000" in record.instrument
    assert record.sample == "NiTi wire"
    peak_flow = record.specific_heat_flow(record.segments[0]).max()
    assert peak_flow == pytest.approx(350.0, rel=1e-3)


@pytest.mark.parametrize("form", ["universal", "flipped", "trios"])
def test_onsets_come_back_from_both_programs(tmp_path: Path, form: str) -> None:
    path = tmp_path / "run.txt"
    if form == "trios":
        trios(path)
    else:
        flipped = form == "flipped"
        universal(path, -1.0 if flipped else 1.0, "UP" if flipped else "DOWN")
    estimates = identify_heating_rates(read_dsc(path)).estimates
    expected = {
        "wire.austenite_start_temperature": 70.0, "wire.austenite_finish_temperature": 95.0,
        "wire.martensite_start_temperature": 80.0, "wire.martensite_finish_temperature": 50.0,
    }
    for name, celsius in expected.items():
        assert estimates[name].value == pytest.approx(celsius + 273.15, abs=0.5), name


def test_rows_of_negative_time_separate_steps_and_are_no_data(tmp_path: Path) -> None:
    path = universal(tmp_path / "q2000.txt")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines.insert(len(HEADER.splitlines()) + 500, "-2\t-2\t-2\t-2")
    path.write_text("\n".join(lines), encoding="utf-8")
    assert len(read_dsc(path).segments) == 3


def test_malformed_line_is_named(tmp_path: Path) -> None:
    path = universal(tmp_path / "q2000.txt")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[40] = "0.5\tabc\t1.0\t0.0"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match="line 41"):
        read_dsc(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Size\t", "Sise\t", "no sample mass"),
        ("mg\nExo", "stone\nExo", "sample mass is 64"),
        ("Heat Flow (mW)", "Heat Flow (cal)", "min, degC, mW"),
        ("Sig1\t", "Sag1\t", "no Sig1, Sig2"),
    ],
)
def test_what_is_missing_is_said(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = universal(tmp_path / "q2000.txt")
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_dsc(path)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cut=st.integers(0, 70_000), junk=st.binary(max_size=20))
def test_damaged_files_are_read_or_refused_in_one_line(
    tmp_path: Path, cut: int, junk: bytes
) -> None:
    whole = universal(tmp_path / "whole.txt").read_bytes()
    path = tmp_path / "damaged.txt"
    path.write_bytes(whole[:cut] + junk)
    try:
        read_dsc(path)
    except InputError as error:
        assert "\n" not in str(error)

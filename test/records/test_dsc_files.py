"""Exports of calorimeters (Pyris, Universal Analysis, TRIOS), good and bad."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from sma_bench.errors import InputError
from sma_bench.identify.transition_temperatures import identify_transition_temperatures
from sma_bench.records import DscRecord, open_record

FILES = Path(__file__).parents[1] / "data" / "dsc"
PYRIS = (FILES / "pyris.txt").read_text(encoding="utf-8")
MASS = 10.2  # mg, also in the file below
HEADER = (FILES / "universal_analysis.txt").read_text(encoding="utf-8")
TRIOS_STEP = "[step]\nRamp 5.00 °C/min to {} °C\nTime\tTemperature\tHeat Flow (Normalized)\n"
ONSETS = {"austenite_start": 70.0, "austenite_finish": 95.0, "martensite_start": 80.0,
          "martensite_finish": 50.0}


def peak(t, start, finish):
    """Rounded trapezoid in W/g; its tangents meet the base line at start and finish, in degC."""
    sharp = np.interp(t, np.linspace(start, finish, 4), [0.0, 0.3, 0.3, 0.0])
    return np.convolve(np.pad(sharp, 20, mode="edge"), np.ones(41) / 41.0, mode="valid")


def scans():
    """Rows of min, degC, W/g (endothermic up): heating, holding and cooling at 5 K/min."""
    up, hold = np.arange(0.0, 180.0, 0.1), np.full(150, 180.0)
    heated, cooled = 0.05 + peak(up, 70.0, 95.0), -0.05 - peak(up, 50.0, 80.0)[::-1]
    t = np.concatenate([up, hold, up[::-1]])
    flow = np.concatenate([heated, np.zeros(len(hold)), cooled])
    return np.column_stack([np.arange(len(t)) * 0.02, t, flow])


def universal(sign=1.0):
    direction = "DOWN" if sign > 0.0 else "UP"
    rows = (f"{a:.6f}\t{b:.5f}\t{sign * MASS * c:.6f}\t0.0\n" for a, b, c in scans())
    return HEADER.replace("DOWN", direction) + "".join(rows)


def trios():
    rows = [f"{a:.2f}\t{b:.2f}\t{c:.4f}\n" for a, b, c in scans()]
    text = f"Filename\tx\n[Procedure]\nSample Name\tNiTi\nSample Mass\t{MASS} mg\n"
    text += "[Configuration]\nInstrument Type\tDSC2500\nExotherm Direction\tDown\n"
    for end, own in (("180.00", rows[:1800]), ("0.00", rows[-1800:])):
        text += f"{TRIOS_STEP.format(end)}min\t°C\tW/g\n{''.join(own)}\n"
    return text


def titled():
    """A plain table with titles and no mass."""
    rows = (f"{a:.6f},{b:.5f},{c:.6f}\n" for a, b, c in scans())
    return "Time (min),Temperature (C),Heat Flow (W/g)\n" + "".join(rows)


@pytest.fixture
def write(tmp_path):
    def write(text, encoding="latin-1"):
        path = tmp_path / "run.txt"
        path.write_bytes(text.encode(encoding))
        return path

    return write


def test_units_are_si_and_the_sign_of_heat_flow_is_found(write):
    run = open_record(write(PYRIS))
    assert run.mass == pytest.approx(10e-6)
    assert run.header["Filename"] == "C:\\run.dcd" and run.sample == "NiTi wire"
    assert [s.kind for s in run.segments] == ["isothermal", "cooling", "heating"]
    assert [s.rate for s in run.segments] == pytest.approx([0, -10 / 60, 20 / 60])
    heating, expected = run.segments[2], {
        "time": [180, 240], "heat_flow": [0.020, 0.021], "baseline": [0.001, 0.001],
        "temperature": [342.15, 361.15], "program_temperature": [343.15, 363.15]}
    for name, values in expected.items():
        assert getattr(heating, name) == pytest.approx(values)
    assert run.specific_heat_flow(heating) == pytest.approx([1900, 2000])
    assert run.endothermic_up is True and run.findings == ()
    (baseline,) = (name for name in run.account.used if "Baseline" in name)
    assert run.account.used[baseline] == "heat flow"
    mettler = PYRIS.replace("Sample Weight:\t10.000 mg", "Curve Name:\nNiTi wire, 10.000 mg")
    assert open_record(write(mettler)).mass == pytest.approx(10e-6)
    # If the method is missing, the program temperature gives the rates.
    run = open_record(write(PYRIS.replace("2)\tCool", "Cool").replace("3)\tHeat", "Heat")))
    assert [s.rate for s in run.segments] == pytest.approx([0, -10 / 60, 20 / 60])
    swapped = PYRIS.replace("\t20.0\t", "\t-20.0\t").replace("\t21.0\t", "\t-21.0\t")
    assert open_record(write(swapped)).endothermic_up is False
    only_hold = PYRIS[: PYRIS.index("2) DSC")].replace("Run:\t5", "Run:\t1")
    assert open_record(write(only_hold)).endothermic_up is None
    windows = write(PYRIS.replace("\n", "\r\n"), "utf-16")
    assert len(open_record(windows).segments) == 3 and isinstance(open_record(windows), DscRecord)


SCAN = PYRIS[PYRIS.index("2) DSC") : PYRIS.index("3) DSC")]
MALFORMED = yaml.safe_load(Path(__file__).with_name("malformed_dsc.yaml").read_text())


@pytest.mark.parametrize(("program", "old", "new", "said"), MALFORMED)
def test_malformed_files_are_refused_with_the_line(write, program, old, new, said):
    text, old = {"pyris": PYRIS, "universal": universal()}[program], old.replace("SCAN", SCAN)
    assert old in text
    with pytest.raises(InputError, match=said) as error:
        open_record(write(text.replace(old, new), "utf-8"))
    assert "\n" not in str(error.value)


def test_file_cut_inside_a_row_is_read_up_to_there(write):
    run = open_record(write(PYRIS[: PYRIS.index("\t90.0\t88.0")]))
    assert len(run.segments[2].time) == 1
    cut_short, announced = (finding.text for finding in run.findings)
    assert "line 21" in cut_short and "cut short" in cut_short
    assert announced.endswith("4 points, the header announces 5; the file may be cut short")


# Rows of negative time separate Universal Analysis's steps and are no data.
PARTED = universal().replace("\n10.000000\t", "\n-2\t-2\t-2\t-2\n10.000000\t")


@pytest.mark.parametrize("lines", [
    f"Pan mass: 48.2 mg\nSample mass: {MASS} mg", f"Sample mass: {MASS} mg\nReference mass: 30 mg",
    f"Sample mass: {MASS} mg\nCrucible mass: 38 mg", "Sample mass: 10,2 mg",
    f"Tare mass: 48 mg; sample mass: {MASS} mg",
])  # fmt: skip
def test_the_mass_is_the_samples(write, lines):
    assert open_record(write(f"{lines}\n{titled()}", "utf-8")).mass == pytest.approx(MASS * 1e-6)


@pytest.mark.parametrize("text", [PARTED, universal(-1.0), trios(), titled()], ids=range(4))
def test_steps_and_onsets_come_back_from_every_program(write, text):
    record = open_record(write(text, "utf-8"))
    assert [s.kind for s in record.segments if s.rate] == ["heating", "cooling"]
    rates = [60.0 * s.rate for s in record.segments if s.rate]
    assert rates == pytest.approx([5.0, -5.0], rel=1e-6 if text != titled() else 0.01)
    assert record.endothermic_up is (text != universal(-1.0))
    if text == PARTED:
        assert record.mass == pytest.approx(MASS * 1e-6) and record.sample == "NiTi wire"
        assert "Q2000" in record.instrument and len(record.segments) == 3
        peak_flow = record.specific_heat_flow(record.segments[0]).max()
        assert peak_flow == pytest.approx(350.0, rel=1e-3)
    assert (text == titled()) == any("no sample mass" in f.text for f in record.findings)
    estimates = identify_transition_temperatures([record]).estimates
    for name, celsius in ONSETS.items():
        found = estimates[f"wire.{name}_temperature"].value
        assert found == pytest.approx(celsius + 273.15, abs=0.5), name


def test_a_french_export_is_read(write):
    rows = (f"{60 * a:.3f};{b:.3f};{10 * c:.4f}\n".replace(".", ",") for a, b, c in scans())
    head = "Masse : 12,3 mg\nTemps (s);Temp. échantillon (°C);Flux de chaleur (mW)\n"
    run = open_record(write(head + "".join(rows)))
    assert run.mass == pytest.approx(12.3e-6) and len(run.segments) == 3


def test_real_file_has_its_eight_segments_and_counts_heat_into_the_sample_positive(measured_data):
    run = open_record(measured_data / "sma_react/input/preprocessor_samples/DSC.txt")
    assert run.mass == pytest.approx(60.2e-6) and run.findings == ()
    assert [60 * s.rate for s in run.segments] == pytest.approx([0, -10, 0, 10, 0, -5, 0, 5])
    assert [len(s.time) for s in run.segments] == [120, 720, 120, 720, 120, 1440, 120, 1920]
    # The transformation to austenite takes heat: the peak on heating points up.
    assert run.endothermic_up is True
    heating = run.segments[3]
    highest = int(np.argmax(run.specific_heat_flow(heating)[60:]))
    assert heating.temperature[60 + highest] == pytest.approx(273.15 + 64.5, abs=0.5)

"""The Pyris export of a calorimeter, in SI units and with line numbers in its errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.records import DscRecord, open_record, read_dsc

SMALL = """Filename:\tC:\\run.dcd
Sample ID:\tNiTi wire
Sample Weight:\t10.000 mg
Total Points in Run:\t5
Filename:\tC:\\calibration.dcc
1)\tHold for 1.0 min at 100.00\xb0C

2)\tCool from 100.00\xb0C to 70.00\xb0C at 10.00\xb0C/min

3)\tHeat from 70.00\xb0C to 100.00\xb0C at 20.00\xb0C/min

1) DSC Isothermal
\tTime     \tUnsubtracted\tBaseline     \tProgram     \tSample     \tApprox.
\t          \tHeat Flow     \tHeat Flow     \tTemperature\tTemperature\tGas Flow
\t0.000000\t10.0\t1.0\t100.0\t99.0\t0.0
2) DSC Temperature Scan
\t1.000000\t5.0\t1.0\t100.0\t99.0\t0.0
\t2.000000\t4.0\t1.0\t90.0\t89.5\t0.0
3) DSC Temperature Scan
\t3.000000\t20.0\t1.0\t70.0\t69.0\t0.0
\t4.000000\t21.0\t1.0\t90.0\t88.0\t0.0


\tTEMPERATURE CALIBRATION INPUTS:
Indium\t156.600\t158.150\tUsed
"""


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "run.txt"
        path.write_bytes(text.encode("latin-1"))
        return path

    return write


def test_units_are_si(write):
    run = read_dsc(write(SMALL))
    assert run.mass == pytest.approx(10e-6)
    assert run.header["Filename"] == "C:\\run.dcd" and run.sample == "NiTi wire"
    assert [s.kind for s in run.segments] == ["isothermal", "cooling", "heating"]
    assert [s.rate for s in run.segments] == pytest.approx([0, -10 / 60, 20 / 60])
    heating = run.segments[2]
    assert heating.time.tolist() == [180, 240]
    assert heating.heat_flow == pytest.approx([0.020, 0.021])
    assert heating.baseline == pytest.approx([0.001, 0.001])
    assert heating.temperature == pytest.approx([342.15, 361.15])
    assert heating.program_temperature == pytest.approx([343.15, 363.15])
    assert run.specific_heat_flow(heating) == pytest.approx([1900, 2000])
    assert run.endothermic_up is True and run.findings == ()


def test_sign_convention_follows_the_run(write):
    swapped = SMALL.replace("\t20.0\t", "\t-20.0\t").replace("\t21.0\t", "\t-21.0\t")
    assert read_dsc(write(swapped)).endothermic_up is False
    only_hold = SMALL[: SMALL.index("2) DSC")].replace("Run:\t5", "Run:\t1")
    assert read_dsc(write(only_hold)).endothermic_up is None


def test_rate_comes_from_the_program_where_the_method_is_missing(write):
    text = SMALL.replace("2)\tCool", "Cool").replace("3)\tHeat", "Heat")
    run = read_dsc(write(text))
    assert [s.rate for s in run.segments] == pytest.approx([0, -10 / 60, 20 / 60])


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("\t4.0\t1.0\t90.0", "\t4.0\t90.0", "line 18"),
        ("\t4.0\t", "\tfour\t", "line 18"),
        ("\t4.0\t", "\tnan\t", "line 18"),
        ("\t2.000000", "\t0.500000", "time runs backward in segment 2"),
        ("10.000 mg", "-1 mg", "Sample Weight is '-1 mg'"),
        ("10.000 mg", "10 g", "Sample Weight is '10 g'"),
        ("Sample Weight", "Weight", "no 'Sample Weight' line"),
        (") DSC", ") DTA", "no columns of temperature and heat flow"),
        (SMALL[SMALL.index("2) DSC") : SMALL.index("3) DSC")], "2) DSC Isothermal\n", "no data"),
    ],
)
def test_malformed_files_are_refused_with_the_line(write, old, new, text):
    with pytest.raises(InputError, match=text) as error:
        read_dsc(write(SMALL.replace(old, new)))
    assert "\n" not in str(error.value)


def test_file_cut_inside_a_row_is_read_up_to_there(write):
    cut = SMALL[: SMALL.index("\t90.0\t88.0")]
    run = read_dsc(write(cut))
    assert len(run.segments[2].time) == 1
    cut_short, announced = (finding.text for finding in run.findings)
    assert "line 21" in cut_short and "cut short" in cut_short
    assert announced == "4 points, the header announces 5; the file may be cut short"


def test_windows_line_ends_and_utf16_are_read_too(tmp_path):
    path = tmp_path / "run.txt"
    path.write_bytes(SMALL.replace("\n", "\r\n").encode("utf-16"))
    assert len(read_dsc(path).segments) == 3
    assert isinstance(open_record(path), DscRecord)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_mutilation_ends_in_a_record_or_one_line(tmp_path_factory, data):
    lines = SMALL.split("\n")
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        lines[at : at + data.draw(st.integers(0, 3))] = data.draw(
            st.lists(st.text(st.characters(max_codepoint=255), max_size=30), max_size=2)
        )
    path = tmp_path_factory.mktemp("dsc") / "run.txt"
    path.write_bytes("\n".join(lines).encode("latin-1"))
    try:
        run = read_dsc(path)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert isinstance(run, DscRecord) and run.mass > 0


def test_real_file_has_its_eight_segments(measured_data):
    run = read_dsc(measured_data / "sma_react/input/preprocessor_samples/DSC.txt")
    assert run.mass == pytest.approx(60.2e-6)
    assert run.findings == ()
    kinds = [s.kind for s in run.segments]
    assert kinds == ["isothermal", "cooling", "isothermal", "heating"] * 2
    assert [60 * s.rate for s in run.segments] == pytest.approx([0, -10, 0, 10, 0, -5, 0, 5])
    assert [len(s.time) for s in run.segments] == [120, 720, 120, 720, 120, 1440, 120, 1920]
    for segment in run.segments:
        if segment.rate:
            slope = np.polyfit(segment.time[60:], segment.program_temperature[60:], 1)[0]
            assert slope == pytest.approx(segment.rate, rel=1e-3)


def test_real_file_counts_heat_into_the_sample_positive(measured_data):
    """Martensite takes heat to become austenite: the peak on heating points up."""
    run = read_dsc(measured_data / "sma_react/input/preprocessor_samples/DSC.txt")
    assert run.endothermic_up is True
    heating = run.segments[3]
    flow = run.specific_heat_flow(heating)[60:]
    peak = int(np.argmax(flow))
    assert heating.temperature[60 + peak] == pytest.approx(273.15 + 64.5, abs=0.5)

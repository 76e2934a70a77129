"""E3 on synthetic ramps: right numbers, honest errors, wrong models noticed."""

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.thermal.ramps import Window
from sma_bench.identify.thermal.specific_heat import slope_of_rates
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import EXACT_SENSORS

R, H, CP = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
WEIGHED = Parameters(
    {n: Parameters.defaults()[n] for n in ("wire.mass", "wire.surface_area")}, EXACT_SENSORS
)
KNOWN = Parameters.of_paper().replace({R: 2.75, H: 410.0}, {R: 0.001, H: 0.4, **EXACT_SENSORS})


def found_cp(*records, parameters=KNOWN):
    found = identify(records, parameters, ["E3"])
    return found, found.estimates[CP]


def remarks(found):
    return [f.text for e in found.experiments for f in e.findings]


def test_specific_heat_comes_back_within_two_errors_of_less_than_one_percent(ramp):
    found, cp = found_cp(ramp(seed=2))
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    assert cp.std < 0.01 * cp.value
    assert found.warnings == ()


def test_wire_in_still_air_with_a_time_constant_of_seconds_works_alike(ramp, wire):
    known = KNOWN.replace({H: 60.0}, {H: 0.1})
    _, cp = found_cp(ramp(wire(coefficient=60.0), top=1.2, seed=1), parameters=known)
    assert abs(cp.value - 350.0) < 2.0 * cp.std < 8.0


def test_differentiated_noise_biases_the_slope_of_the_paper_and_not_the_fit(ramp):
    found, cp = found_cp(ramp(seed=5))
    paper = found.experiments[0].details["differentiator"]
    assert abs(paper.value - 350.0) > 10.0 * abs(cp.value - 350.0)
    assert "biased by noise" in paper.method
    curves = found.experiments[0].curves
    assert len(curves["force"]) == len(curves["rate"]) == paper.n
    assert len(curves["temperature"]) == len(curves["model"]) == len(curves["voltage"])


def test_offset_between_the_clocks_is_told_from_thermal_inertia(ramp, sensors):
    delay = 0.02
    found, cp = found_cp(ramp(sensors=sensors(100.0, 80.0, delay=delay), seed=1))
    # A camera's lag of some milliseconds looks like a delay: the two are known together.
    late = [f.numbers for f in found.experiments[0].findings if "delay" in f.numbers][0]
    assert abs(late["delay"] - delay) < 2.5 * late["delay_std"] < 0.006
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    assert any("pass for thermal inertia" in text for text in remarks(found))


def test_without_a_jump_the_clock_offset_stays_in_the_error(ramp):
    found, cp = found_cp(ramp(rest=0.0, repeat=1))
    assert any("cannot be told from thermal inertia" in text for text in remarks(found))
    assert cp.std / cp.informed**0.5 > 0.03 * cp.value  # before it was joined with the known


def test_temperature_above_austenite_start_is_noticed_and_left_out(ramp):
    found, cp = found_cp(ramp(top=4.2))
    (warning,) = [w for w in found.warnings if "above A_s" in w]
    assert "A_s = 331.8 K" in warning
    model = found.experiments[0].curves["temperature"]
    assert np.nanmax(model) < 331.81 + 0.5
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    found, cp = found_cp(ramp(), ramp(top=4.2, seed=1))
    assert cp.n == found_cp(ramp())[1].n
    assert any("4 of 8 ramps are left out" in text for text in remarks(found))


def test_second_thermal_mass_is_noticed_in_the_residuals(ramp):
    found, cp = found_cp(ramp(lag=0.1, seed=3))
    assert abs(cp.value - 350.0) < 2.5 * cp.std
    assert any("pass for thermal inertia" in text for text in remarks(found))
    assert any("two time constants" in w and "does not follow eq. (2)" in w for w in found.warnings)


def test_ramps_alone_give_specific_heat_and_coefficient_together(ramp):
    found, cp = found_cp(ramp(), parameters=WEIGHED.replace({R: 2.75}, {R: 0.001}))
    h = found.estimates[H]
    assert abs(h.value - 410.0) < 2.5 * h.std < 8.0
    assert abs(cp.value - 350.0) < 2.5 * cp.std < 8.0


def test_ramps_that_contradict_the_known_heat_loss_or_do_not_warm_are_noticed(ramp, wire):
    found, cp = found_cp(ramp(wire(coefficient=380.0)))
    assert any("ask for a steady rise +7." in w for w in found.warnings)
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    with pytest.raises(InputError, match="temperature rises by .* expected 10 times"):
        found_cp(ramp(top=0.2))


def test_ramps_shorter_than_the_filter_are_one_line():
    time = np.arange(4) * 0.01
    window = Window(time, np.ones(4), time, np.full(4, 300.0))
    with pytest.raises(InputError, match="longer than the filter"):
        slope_of_rates([window], [300.0], 2.7, 0.1, 1e-4)

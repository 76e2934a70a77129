"""Phase: eqs. (10), (11) and the rule between reversals, over random histories."""

import numpy as np
import pytest
from effect_references import alloy
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.parameters import Parameters
from sma_bench.physics import material

DEFAULTS = Parameters.of_paper()

# Start, width and influence of either range: overlapping, nested and swapped ranges among them.
RANGES = (st.floats(315, 345), st.floats(2, 40), st.floats(305, 345), st.floats(2, 40))
alloys = st.builds(
    lambda ranges, influences: DEFAULTS.replace(alloy(ranges, influences)),
    st.tuples(*RANGES),
    st.tuples(st.floats(4e6, 15e6), st.floats(4e6, 15e6)),
)


class Wire:
    """Follows the rule along a path of temperature and stress."""

    def __init__(self, parameters, kelvin=290.0, sigma=0.0):
        self.parameters, self.rising, self.xi = parameters, True, 1.0
        self.kelvin, self.sigma = kelvin, sigma
        self.xi = float(material.austenite_ramp(kelvin, sigma, parameters))
        self.reverse()

    def ramps(self, kelvin, sigma):
        return (
            float(material.austenite_ramp(kelvin, sigma, self.parameters)),
            float(material.martensite_ramp(kelvin, sigma, self.parameters)),
        )

    def reverse(self):
        self.xi_reversed, self.ramps_reversed = self.xi, self.ramps(self.kelvin, self.sigma)

    def at(self, kelvin, sigma):
        return material.fraction_since_reversal(
            self.rising, self.xi_reversed, self.ramps_reversed, self.ramps(kelvin, sigma)
        )

    def go(self, kelvin, sigma, steps=60):
        """Straight to a temperature and stress; the fractions on the way, the first included."""
        if kelvin != self.kelvin and (kelvin > self.kelvin) != self.rising:
            self.rising = kelvin > self.kelvin
            self.reverse()
        way = zip(
            np.linspace(self.kelvin, kelvin, steps),
            np.linspace(self.sigma, sigma, steps),
            strict=True,
        )
        path = np.array([self.at(*point) for point in way])
        self.kelvin, self.sigma, self.xi = kelvin, sigma, path[-1]
        return path


def test_partial_loop_is_that_of_liang_and_rogers_where_the_ranges_do_not_overlap():
    alloy = DEFAULTS.replace(
        {"wire.martensite_start_temperature": 325.0, "wire.martensite_finish_temperature": 310.0}
    )
    wire = Wire(alloy)
    wire.go(343.0, 0.0)
    half = wire.xi
    cooled = wire.go(317.0, 0.0)
    # Their cooling: xi = (1 - xi_A)/2 cos[a_M (T - M_f)] + (1 + xi_A)/2, xi_A before cooling.
    there = 0.5 * (1 - half) * np.cos(np.pi / 15.0 * (317.0 - 310.0)) + 0.5 * (1 + half)
    assert cooled[-1] == pytest.approx(there, abs=1e-12)
    kept = wire.xi
    reheated = wire.go(340.0, 0.0)
    # Their heating: xi = xi_M/2 {cos[a_A (T - A_s)] + 1}.
    back = 0.5 * kept * (np.cos(np.pi / 21.8 * (340.0 - 331.81)) + 1)
    assert reheated[-1] == pytest.approx(back, abs=1e-12)


@settings(deadline=None)
@given(
    alloys,
    st.lists(st.tuples(st.floats(290, 420), st.floats(-2e8, 5e8)), min_size=2, max_size=6),
)
def test_with_moving_stress_no_branch_jumps(alloy, path):
    """Ever finer samples of the steepest place: a step halves with the distance, a jump stays."""
    wire = Wire(alloy, 250.0)
    for kelvin, sigma in path[:-1]:
        wire.go(kelvin, sigma)
    start = (wire.kelvin, wire.sigma)
    end = path[-1]
    branch = wire.go(*end, steps=200)
    k = int(np.argmax(np.abs(np.diff(branch))))

    def point(share):
        return wire.at(
            start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
        )

    low, high = k / 199, (k + 1) / 199
    for _ in range(45):
        middle = 0.5 * (low + high)
        left, right = abs(point(middle) - point(low)), abs(point(high) - point(middle))
        low, high = (low, middle) if left > right else (middle, high)
    assert abs(point(high) - point(low)) < 1e-4


def test_stress_is_the_constitutive_law_from_rest():
    assert material.stress(296.15, 1.0, 0.0, DEFAULTS) == 0.0
    # eq. (6) by hand: E = 39.1 GPa, Omega = -0.044 E, xi - xi_0 = -0.5, T - T_0 = 40 K.
    by_hand = -39.1e9 * 0.01 - 0.15e6 * 40.0 + 0.044 * 39.1e9 * 0.5
    assert material.stress(336.15, 0.5, 0.01, DEFAULTS) == pytest.approx(by_hand)
    assert material.modulus(0.5, DEFAULTS) == pytest.approx(39.1e9)
    assert material.transformation_coefficient(0.5, DEFAULTS) == pytest.approx(-0.044 * 39.1e9)
    assert material.clamped_stress(316.15, DEFAULTS) == pytest.approx(-3.0e6)

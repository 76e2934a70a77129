"""The linearised model, eqs. (18) to (23) derived anew: a state-space model about any point.

With deviations from the operating point (T, v, sigma, ...), for the wires i of a side:

    m c_p dT_i/dt = -h A_c T_i + (2 V_i*/R) v_i + m Delta_h dxi_i/dt                      (1), (19)
    sigma_i = -a_1 e + Theta_T T_i + c xi_i,    c = -eps_L E_A + a_2                      (18)
    xi_i    = r (-T_i + sigma_i/C),    r = s b_1 with C_A, or s b_3 with C_M              (20), (21)
    sum sigma_i = K e    (composite: K = alpha beta, deflection = +-alpha e)              (22), (23)
    (a weight: K = 0; a spring: its own; antagonists: the front's sum less the back's, e_b = -e_f)

where s, 1 on a full loop, is the share of the branch that a partial loop follows. Everything but T
is algebraic, so the states are the wires' temperatures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import StateSpace

from sma_bench.errors import InputError
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics import material
from sma_bench.physics.boundary import per_side, side_names, side_of_channels
from sma_bench.physics.effects import active_effects
from sma_bench.physics.heat import heated_resistance, power_per_volt, time_constant
from sma_bench.physics.operating_point import OperatingPoint

Array = NDArray[np.float64]
Input = Literal["voltage", "power"]
SMOOTHER = ("wire.transition_spread", "wire.transition_tail")
_Row = tuple[str, str, str, ArrayLike, ArrayLike, str]


@dataclass(frozen=True, eq=False)
class Linearised:
    """First-order change of everything per kelvin of each wire, and the temperatures' dynamics.

    Attributes:
        point: where; latent_heat: J/kg, as it was linearised with.
        fraction_per_kelvin, stress_per_kelvin: (w, w), row: wire that changes, column: wire that
            warms; 1/K and Pa/K.
        contraction_per_kelvin: (s, w) 1/K.
    """

    point: OperatingPoint
    latent_heat: float
    fraction_per_kelvin: Array
    stress_per_kelvin: Array
    contraction_per_kelvin: Array

    @cached_property
    def deflection_per_kelvin(self) -> Array:
        """(w,) m/K."""
        sides = self.contraction_per_kelvin.shape[0]
        levers = per_side("lever", self.point.boundary.lever, sides)
        return np.asarray(levers @ self.contraction_per_kelvin)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs of `state_space`, in their order."""
        channels = self.point.parameters["bench.channels"]
        return (
            "deflection",
            *(f"{channel}.temperature" for channel in channels),
            *(f"{channel}.stress" for channel in channels),
        )

    def state_space(self, inputs: Input = "voltage") -> StateSpace:
        """Deviations of wire temperatures [K] driven by those of the wires' inputs.

        Outputs, 1 + 2 w: deflection [m], temperatures [K], stresses [Pa].

        Args:
            inputs: "voltage" [V], eq. (19), or "power" [W], in which eq. (2) is linear as it is.
        """
        parameters, wires = self.point.parameters, self.point.temperature.size
        latent_rise = self.latent_heat / parameters["wire.specific_heat"]
        # Latent heat makes a transforming wire heavier: (1 - Delta_h/c_p dxi/dT) dT/dt = ...
        lightness = np.linalg.inv(np.eye(wires) - latent_rise * self.fraction_per_kelvin)
        capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
        per_input = {
            "voltage": power_per_volt(self.point.voltage, parameters), "power": np.ones(wires)
        }[inputs]
        c = np.vstack([self.deflection_per_kelvin, np.eye(wires), self.stress_per_kelvin])
        return StateSpace(
            -lightness / time_constant(parameters), lightness * per_input / capacity, c,
            np.zeros((c.shape[0], wires)),
        )

    def deflection_per_volt(self) -> Array:
        """(w,) m/V, steady: what a lasting change of each voltage leads to."""
        parameters = self.point.parameters
        capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
        heating = power_per_volt(self.point.voltage, parameters)
        return self.deflection_per_kelvin * heating * time_constant(parameters) / capacity


def linearise(point: OperatingPoint, latent_heat: float = 0.0) -> Linearised:
    """The linearised model about an operating point, for changes along its branch.

    Args:
        latent_heat: Delta_h of eq. (1) [J/kg].

    Raises:
        InputError: the stresses do not determine the state (a vertical tangent), or an effect or
            a smoother ramp than eqs. (10), (11) is on.
    """
    parameters = point.parameters
    beyond = [*active_effects(parameters), *(n for n in SMOOTHER if parameters[n] != 0.0)]
    if beyond:
        raise InputError(f"linearisation: {beyond[0]} is on, expected eqs. (10), (11) as they are")
    side = side_of_channels(parameters)
    strain = point.boundary.stretch_of_wires(parameters) - point.contraction[side]
    modulus = linear.a1(point.martensite_fraction, parameters)
    pull = linear.a2(point.martensite_fraction, strain, parameters) - (
        parameters["wire.maximum_recoverable_strain"] * parameters["wire.austenite_modulus"]
    )
    rate, influence = transformation_rate(point)
    kept = 1.0 - pull * rate / influence
    if np.any(kept <= 0.0):
        raise InputError(
            f"linearisation: at {point.temperature} K stress drives the transformation by itself, "
            "expected a stable state"
        )
    # Of one wire, its transformation included: dsigma = push dT - softness de.
    push = (parameters["wire.thermal_expansion_factor"] - pull * rate) / kept
    softness = modulus / kept
    contraction = _contraction_per_kelvin(point, softness, push)
    sigma = np.diag(push) - softness[:, np.newaxis] * contraction[side]
    xi = -np.diag(rate) + (rate / influence)[:, np.newaxis] * sigma
    return Linearised(point, latent_heat, xi, sigma, contraction)


def transformation_rate(point: OperatingPoint) -> tuple[Array, float]:
    """-dxi/dT [1/K] of each wire at constant stress on its branch, and C_A or C_M [Pa/K]."""
    parameters, xi = point.parameters, point.martensite_fraction
    if point.branch == "heating":
        slope = linear.b1(point.temperature, point.stress, parameters)
        ramp = material.austenite_ramp(point.temperature, point.stress, parameters)
        vanishing, influence = xi, parameters["wire.stress_influence_austenite"]
    else:
        slope = linear.b3(point.temperature, point.stress, parameters)
        ramp = material.martensite_ramp(point.temperature, point.stress, parameters)
        vanishing, influence = 1.0 - xi, parameters["wire.stress_influence_martensite"]
    share = np.divide(vanishing, ramp, out=np.ones_like(ramp), where=ramp > 0.0)
    return share * slope, float(influence)


def _contraction_per_kelvin(point: OperatingPoint, softness: Array, push: Array) -> Array:
    """(s, w): sum over a side of (push dT - softness de) = K de."""
    parameters = point.parameters
    sides = len(side_names(parameters))
    change = np.zeros((sides, point.temperature.size))
    if point.boundary.contraction is not None:
        return change
    side = side_of_channels(parameters)
    stiffness = per_side("stiffness", point.boundary.stiffness, sides)
    if point.boundary.coupled:  # sum_front (push dT - softness de) - sum_back (...) = K de
        change[0] = np.where(side == 0, push, -push) / (stiffness[0] + softness.sum())
        change[1] = -change[0]
        return change
    stiffness = stiffness + np.bincount(side, softness, sides)
    change[side, np.arange(side.size)] = push / stiffness[side]
    return change


def printed_deflection_per_kelvin(point: OperatingPoint, wire: int = 0) -> float:
    """d deflection/dT [m/K] that eqs. (18), (20) to (23) give as they are printed, for one wire."""
    parameters = point.parameters
    xi, strain = point.martensite_fraction[wire], _strain(point, wire)
    a, b = linear.alpha_as_printed(parameters), linear.beta_as_printed(parameters)
    pull = float(linear.a2_as_printed(xi, strain, parameters)) - (
        parameters["wire.maximum_recoverable_strain"] * parameters["wire.austenite_modulus"]
    )
    printed = linear.b1_as_printed if point.branch == "heating" else linear.b3_as_printed
    rate = float(printed(point.temperature[wire], point.stress[wire], parameters))
    # beta delta = a_1 delta/alpha + Theta T + pull xi,  xi = rate (-T + beta delta)
    stiffness = b - float(linear.a1(xi, parameters)) / a - pull * rate * b
    return (parameters["wire.thermal_expansion_factor"] - pull * rate) / stiffness


@dataclass(frozen=True)
class Coefficient:
    """A row of `coefficient_table`: printed and corrected values, NaN where there is none."""

    name: str
    equation: str
    unit: str
    printed: float
    corrected: float
    remark: str


def coefficient_table(point: OperatingPoint, wire: int = 0) -> list[Coefficient]:
    """Every coefficient of eqs. (18) to (23), printed beside corrected, for one wire at a point.

    Raises:
        InputError: no such wire.
    """
    if not 0 <= wire < point.temperature.size:
        raise InputError(f"wire {wire}, expected 0 to {point.temperature.size - 1}")
    parameters = point.parameters
    xi, strain = point.martensite_fraction[wire], _strain(point, wire)
    at = (point.temperature[wire], point.stress[wire], parameters)
    volt, ohm = point.voltage[wire], heated_resistance(parameters)
    rows: list[_Row] = [
        ("a_1", "(18)", "Pa", linear.a1(xi, parameters), linear.a1(xi, parameters), "right"),
        ("a_2", "(18)", "Pa", linear.a2_as_printed(xi, strain, parameters),
         linear.a2(xi, strain, parameters), "sign of eps* - eps_0"),
        ("a_3", "(18)", "Pa", linear.a3_as_printed(xi, strain, parameters),
         linear.a3(xi, strain, parameters), "sign of eps* - eps_0"),
        ("heating at V*", "(19)", "W", linear.linear_heating_as_printed(volt, volt, ohm),
         linear.linear_heating(volt, volt, ohm), "+(V*/R)(2V - V*), not -(V*/R)(1 + 2V)"),
        ("heating per volt", "(19)", "W/V", -2.0 * volt / ohm, 2.0 * volt / ohm, "sign"),
        ("b_1", "(20)", "1/K", linear.b1_as_printed(*at), linear.b1(*at), "factor pi/(A_f - A_s)"),
        ("b_1 of stress", "(20)", "1/Pa", linear.b1_as_printed(*at), linear.b1_of_stress(*at),
         "sigma needs 1/C_A"),
        ("b_2", "(20)", "1", linear.b2(*at), linear.b2(*at), "right"),
        ("b_3", "(21)", "1/K", linear.b3_as_printed(*at), linear.b3(*at), "factor pi/(M_s - M_f)"),
        ("b_3 of stress", "(21)", "1/Pa", linear.b3_as_printed(*at), linear.b3_of_stress(*at),
         "sigma needs 1/C_M"),
        ("b_4", "(21)", "1", linear.b4(*at), linear.b4(*at), "right"),
        *_bending_rows(point, wire),
    ]
    return [
        Coefficient(name, equation, unit, _number(printed), _number(corrected), remark)
        for name, equation, unit, printed, corrected, remark in rows
    ]


def _bending_rows(
    point: OperatingPoint, wire: int
) -> Sequence[_Row]:
    parameters = point.parameters
    if point.boundary.contraction is not None or load_kind(parameters) != "beam":
        return ()
    a, side = linear.alpha(parameters), parameters["bench.channel_sides"][wire]
    a_printed, b_printed = linear.alpha_as_printed(parameters), linear.beta_as_printed(parameters)
    b, modulus = linear.beta(parameters, side), _number(
        linear.a1(point.martensite_fraction[wire], parameters)
    )
    together = np.count_nonzero(np.array(parameters["bench.channel_sides"]) == side)
    gain = abs(float(linearise(point).deflection_per_kelvin[wire]))
    return (
        ("alpha", "(22)", "m", a_printed, a, "3 l^2/h_c, not 6: eq. (16) integrated twice"),
        ("strain per deflection", "(22)", "1/m", 1.0 / a_printed, -1.0 / a,
         "the strain is a contraction"),
        ("beta", "(23)", "Pa/m", b_printed, b, "EI of eq. (14): width and brackets"),
        ("stiffness", "(22), (23)", "Pa/m", b_printed - modulus / a_printed,
         b + together * modulus / a, "beta + sum E/alpha, not beta - E/alpha"),
        ("deflection per kelvin", "(18)-(23)", "m/K", printed_deflection_per_kelvin(point, wire),
         gain, "all of the above; magnitude, one wire"),
    )


def _strain(point: OperatingPoint, wire: int) -> float:
    side = side_of_channels(point.parameters)
    stretch = point.boundary.stretch_of_wires(point.parameters)
    return float((stretch - point.contraction[side])[wire])


def _number(value: ArrayLike) -> float:
    return float(np.asarray(value))


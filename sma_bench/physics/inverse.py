"""The model of one side turned round: the temperature at which its wires bend as wanted.

Along a branch xi = s f (heating) or 1 - xi = s g (cooling), with the ramps f, g of phase.py and a
share s that is constant between two reversals: xi_r/f_r or (1 - xi_r)/g_r, and 1 on a full loop.
A wanted contraction e fixes the stress, sigma = (load + K e)/n, the constitutive law then fixes
xi up to the small thermal stress, and the branch fixes the temperature.
"""

import math
from dataclasses import dataclass
from typing import Literal, Self

from scipy.optimize import brentq

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels

Branch = Literal["heating", "cooling"]

_TEMPERATURE_TOLERANCE = 1e-11  # K


@dataclass(frozen=True)
class SideModel:
    """Constants of n equal wires that pull together against a boundary that gives.

    Attributes:
        wires: n; stiffness: K [Pa]; load: [Pa]; lever: m, signed deflection per contraction.
        start, finish, influence: by branch, where the ramp leaves 0 (M_f) or 1 (A_s), where it
            ends, and C [Pa/K].
        modulus: E_A; modulus_change: E_M - E_A [Pa]; recoverable_strain: eps_L.
        expansion: Theta_T [Pa/K]; ambient: T_inf [K].
    """

    wires: int
    stiffness: float
    load: float
    lever: float
    ranges: dict[Branch, tuple[float, float, float]]
    modulus: float
    modulus_change: float
    recoverable_strain: float
    expansion: float
    ambient: float

    @classmethod
    def of(cls, parameters: Parameters, side: str, boundary: Boundary | None = None) -> Self:
        """The wires of `side`, bending the composite unless another boundary is given.

        Raises:
            InputError: no wire on that side, or ends that do not give.
        """
        names = side_names(parameters)
        if side not in names:
            raise InputError(f"no wire on the {side}, expected {' or '.join(names)}")
        boundary = boundary or Boundary.of(parameters)
        if boundary.contraction is not None:
            raise InputError(f"the wires of the {side} are clamped, they do not contract")
        number = names.index(side)
        wire = {key.removeprefix("wire."): parameters[key] for key in parameters if "wire." in key}
        return cls(
            wires=int((side_of_channels(parameters) == number).sum()),
            stiffness=float(per_side("stiffness", boundary.stiffness, len(names))[number]),
            load=float(per_side("load", boundary.load, len(names))[number]),
            lever=float(per_side("lever", boundary.lever, len(names))[number]),
            ranges={
                "heating": (
                    wire["austenite_start_temperature"], wire["austenite_finish_temperature"],
                    wire["stress_influence_austenite"],
                ),
                "cooling": (
                    wire["martensite_finish_temperature"], wire["martensite_start_temperature"],
                    wire["stress_influence_martensite"],
                ),
            },
            modulus=wire["austenite_modulus"],
            modulus_change=wire["martensite_modulus"] - wire["austenite_modulus"],
            recoverable_strain=wire["maximum_recoverable_strain"],
            expansion=wire["thermal_expansion_factor"],
            ambient=parameters["environment.ambient_temperature"],
        )

    def wire_stress(self, contraction: float) -> float:
        """sigma [Pa] of one wire that the boundary asks for at a contraction."""
        return (self.load + self.stiffness * contraction) / self.wires

    def fraction(self, contraction: float, temperature: float) -> float:
        """xi that gives a wire that stress, eq. (6); outside 0 to 1 where none does."""
        thermal = self.expansion * (temperature - self.ambient)
        stretch = self.recoverable_strain - contraction
        square = -self.modulus_change * self.recoverable_strain
        slope = self.modulus_change * stretch - self.modulus * self.recoverable_strain
        constant = self.modulus * stretch + thermal - self.wire_stress(contraction)
        root = math.sqrt(max(slope**2 - 4.0 * square * constant, 0.0))
        return 2.0 * constant / (root - slope)

    def ramp(self, temperature: float, sigma: float, branch: Branch) -> float:
        """f(T, sigma) on heating, g(T, sigma) on cooling."""
        start, finish, influence = self.ranges[branch]
        position = (temperature - start - sigma / influence) / (finish - start)
        if branch == "heating":
            position = 1.0 - position
        return math.sin(0.5 * math.pi * min(max(position, 0.0), 1.0)) ** 2

    def share(self, temperature: float, sigma: float, xi: float, branch: Branch) -> float:
        """s of the branch that leaves from a state; 1 where the ramp is 0 and any would do."""
        ramp = self.ramp(temperature, sigma, branch)
        left = xi if branch == "heating" else 1.0 - xi
        return left / ramp if ramp > 0.0 else 1.0

    def temperature(self, contraction: float, branch: Branch, share: float = 1.0) -> float:
        """T [K] at a contraction along a branch; the end of the transformation beyond it.

        Where the thermal stress alone gives the contraction, before the transformation begins,
        that temperature.
        """
        sigma = self.wire_stress(contraction)
        start, finish, influence = self.ranges[branch]
        low, high = start + sigma / influence, finish + sigma / influence

        def excess(temperature: float) -> float:
            wanted = self.fraction(contraction, temperature)
            left = wanted if branch == "heating" else 1.0 - wanted
            ahead = left - min(share * self.ramp(temperature, sigma, branch), 1.0)
            return ahead if branch == "heating" else -ahead

        if excess(high) < 0.0:
            return high
        if excess(low) > 0.0:
            return self._before_transformation(contraction, sigma, branch, share, low)
        return float(brentq(excess, low, high, xtol=_TEMPERATURE_TOLERANCE))

    def largest_contraction(self) -> float:
        """e at which the wires, heated, have just become austenite: T = A_f + sigma/C_A."""
        _, finish, influence = self.ranges["heating"]
        thermal = self.expansion * (finish - self.ambient)
        # sigma = E_A (eps_L - e) + Theta_T (A_f + sigma/C_A - T_inf) = (load + K e)/n
        pull = self.modulus * self.recoverable_strain + thermal
        kept = 1.0 - self.expansion / influence
        stiffness = kept * self.stiffness / self.wires + self.modulus
        return (pull - kept * self.load / self.wires) / stiffness

    def _before_transformation(
        self, contraction: float, sigma: float, branch: Branch, share: float, low: float
    ) -> float:
        xi = share if branch == "heating" else 1.0
        stretch = self.recoverable_strain * (1.0 - xi) - contraction
        elastic = (self.modulus + xi * self.modulus_change) * stretch
        if self.expansion == 0.0:
            return low
        return min(max(self.ambient + (sigma - elastic) / self.expansion, self.ambient), low)

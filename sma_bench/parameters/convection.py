"""Heat that still air and radiation take from a thin wire, and how it grows with temperature.

`wire.convection: free` is h(T) of Churchill and Chu (1975) for the wire's diameter, as a power of
the excess over air, and grey radiation beside it; `wire.heat_transfer_coefficient` is what both
give 60 K above ambient, and theirs where nobody states it.
"""

import math

GRAVITY = 9.81  # m/s2
STEFAN_BOLTZMANN = 5.670e-8  # W/(m2 K4)
REFERENCE_EXCESS = 60.0  # K above ambient, of the coefficient that results name
OXIDISED = 0.4  # emissivity of a drawn wire with its oxide
_EXCESSES = (30.0, 120.0)  # K, between which the exponent is taken


def natural_convection(diameter: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of a horizontal cylinder in still air, of Churchill and
    Chu (1975), air at film temperature and 1 atm. `diameter` [m]; `surface`, `ambient`:
    temperatures [K], surface above ambient."""
    film = 0.5 * (surface + ambient)
    conductivity = 0.0241 * (film / 273.15) ** 0.81
    viscosity = 1.716e-5 * (film / 273.15) ** 1.5 * (273.15 + 110.4) / (film + 110.4)
    density = 101325.0 / (287.05 * film)
    heat_capacity = 1007.0
    prandtl = viscosity * heat_capacity / conductivity
    diffusivity = conductivity / (density * heat_capacity)
    rayleigh = (
        GRAVITY * (surface - ambient) * diameter**3 / (film * (viscosity / density) * diffusivity)
    )
    shape = (1.0 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    nusselt = (0.60 + 0.387 * rayleigh ** (1 / 6) / shape) ** 2
    return nusselt * conductivity / diameter


def radiation(emissivity: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of grey radiation to surroundings at `ambient` [K]."""
    return emissivity * STEFAN_BOLTZMANN * (surface**2 + ambient**2) * (surface + ambient)


def free_coefficient(diameter: float, ambient: float) -> float:
    """h [W/(m2 K)] of a bare wire of that diameter [m] in still air, 60 K above ambient [K]."""
    surface = ambient + REFERENCE_EXCESS
    return natural_convection(diameter, surface, ambient) + radiation(OXIDISED, surface, ambient)


def free_exponent(diameter: float, ambient: float) -> float:
    """n of convection's part of h, in proportion to (T - ambient)^n."""
    cool, hot = (natural_convection(diameter, ambient + e, ambient) for e in _EXCESSES)
    return math.log(hot / cool) / math.log(_EXCESSES[1] / _EXCESSES[0])

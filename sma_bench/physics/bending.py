"""Bending of the composite: eqs. (12) to (17), (22), (23), corrected (printed: paper/printed.py).

EI and the curvature use the martensite's modulus for the active layer: both describe the specimen
at rest and are constants of the model, unlike E(xi) of eq. (7)."""

from dataclasses import dataclass, replace

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import wire_section


@dataclass(frozen=True)
class Beam:
    """Two-layer beam: the elastomer matrix (passive) and the sheet of wires (active)."""

    length: float  # l [m], from the clamping to the point of measurement
    width: float  # w_c [m]
    thickness: float  # h_c [m], of the matrix
    modulus: float  # E_c [Pa], of the matrix
    layer_thickness: float  # h [m], of the active layer
    layer_modulus: float  # E [Pa], of the active layer
    layer_width: float  # w_s [m], of the active layer: real wires fill a small part of w_c
    offset: float  # a [m], wires to centre line
    wire_section: float  # A [m2], cross-section of the wires of one channel

    @classmethod
    def of(cls, p: Parameters) -> "Beam":
        """The beam of a parameter set, martensite in its active layer."""
        return cls(p["composite.length"], p["composite.width"], p["composite.thickness"],
                   p["composite.modulus"], p["composite.wire_layer_thickness"],
                   p["wire.martensite_modulus"], wire_layer_width(p), p["composite.wire_offset"],
                   channel_section(p))


def channel_section(parameters: Parameters) -> float:
    """Cross-section [m2] of the wires of one channel together."""
    return wire_section(parameters) * float(parameters["wire.count"])


def wire_layer_width(parameters: Parameters) -> float:
    """Width [m] of the active layer, with the section of a side's wires (mean of the sides)."""
    if given := parameters["composite.wire_layer_width"]:
        return float(given)
    sides = parameters["bench.channel_sides"]
    section = channel_section(parameters) * len(sides) / len(set(sides))
    return section / float(parameters["composite.wire_layer_thickness"])


def _of_one_width(beam: Beam) -> Beam:
    """The equivalent beam with a layer as wide as the matrix, of modulus E w_s/w_c."""
    modulus = beam.layer_modulus * beam.layer_width / beam.width
    return replace(beam, layer_modulus=modulus, layer_width=beam.width)


def stiffness_terms(beam: Beam, factor: float) -> float:
    """The bracket of eq. (14) [Pa2 m4], with its first term multiplied by `factor`."""
    passive, active = beam.thickness, beam.layer_thickness
    mixed = 4.0 * passive**2 + 6.0 * passive * active + 4.0 * active**2
    both = beam.modulus * passive * (beam.layer_modulus * active) * mixed
    return factor * beam.modulus**2 * passive**4 + both + beam.layer_modulus**2 * active**4


def bending_stiffness(beam: Beam) -> float:
    """EI [N m2], eq. (14) corrected: two layers about the neutral axis, every term multiplied by
    the width and divided by 12 (E_c h_c + E h)."""
    beam = _of_one_width(beam)
    matrix, layer = beam.modulus * beam.thickness, beam.layer_modulus * beam.layer_thickness
    return beam.width * stiffness_terms(beam, 1.0) / (12.0 * (matrix + layer))


def curvature(strain: float, beam: Beam) -> float:
    """Curvature kappa = d phi/dx [1/m] from the strain of the active layer, eq. (16)."""
    m = _of_one_width(beam).layer_modulus / beam.modulus
    t = beam.layer_thickness / beam.thickness
    denominator = 1.0 + m**2 * t**4 + m * t * (4.0 + 6.0 * t + 4.0 * t**2)
    return 6.0 * strain / beam.thickness * m * t * (1.0 + t) / denominator


def deflection(strain: float, beam: Beam) -> float:
    """Deflection [m] at l, eq. (17) corrected: eq. (16) integrated twice gives kappa l^2/2. At
    a strain of 1 it is alpha [m] of eq. (22), corrected: l^2 kappa/(2 eps)."""
    return 0.5 * beam.length**2 * curvature(strain, beam)


def bending_coefficients(parameters: Parameters) -> tuple[float, float, float]:
    """alpha [m], beta of the front and of the back [Pa/m]: given, or from the geometry where 0."""
    names = ("deflection_per_strain", "stress_per_deflection_front", "stress_per_deflection_back")
    alpha, front, back = (parameters[f"composite.{name}"] for name in names)
    if alpha and front and back:
        return alpha, front, back
    beam = Beam.of(parameters)
    # Eq. (23), corrected: 2 EI/(a A l^2), with P = A sum(sigma) over a side's wires.
    beta = 2.0 * bending_stiffness(beam) / (beam.offset * beam.wire_section * beam.length**2)
    return alpha or deflection(1.0, beam), front or beta, back or beta

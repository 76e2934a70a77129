"""The paper's errata: printed and corrected forms side by side, with numbers where there are any.

Geometry, C_A and C_M are not in the paper; the defaults of the parameter table, marked assumed
there, stand in. All other numbers are the paper's own.
"""

from collections.abc import Sequence

from sma_bench.parameters import Parameters, audit
from sma_bench.physics.bending import Beam
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection
from sma_bench.report import errata_of_equations as equations
from sma_bench.report import errata_of_numbers as numbers
from sma_bench.report.erratum import Erratum
from sma_bench.report.page import Section

_RIG = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}


def paper_errata() -> list[Erratum]:
    """All items, evaluated with the paper's numbers."""
    paper = Parameters.defaults()
    rig = paper.replace(_RIG)
    point = OperatingPoint.at_deflection(rig, 0.5 * maximum_deflection(rig), "heating")
    beam = Beam.of(rig)
    findings = {finding.subject: finding for finding in audit(paper)}
    return [
        equations.stiffness(beam),
        equations.deflection_of_strain(beam),
        equations.signs(point),
        equations.constitutive(point),
        equations.heating(point),
        equations.kinetics(point),
        numbers.order(findings["transition order"]),
        numbers.lengths(findings["wire length"], findings["resistivity"]),
        numbers.convection(findings["heat transfer"], findings["time constant"]),
        numbers.expansion(paper),
        numbers.purge_gas(),
    ]


def errata_sections(errata: Sequence[Erratum]) -> list[Section]:
    """For a report: one section each, after a word on what they are."""
    head = Section(
        "Errata",
        ["Where the paper is wrong, and what the package computes instead. Printed forms stay "
         "callable (functions named as_printed) and are evaluated here with the paper's numbers; "
         "geometry, C_A and C_M, which it does not give, are assumed (docs/parameters.md)."],
    )
    return [head, *(erratum.section() for erratum in errata)]


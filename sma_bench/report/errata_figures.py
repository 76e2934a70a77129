"""What the slips of eqs. (17) and (20) do, drawn."""

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import bending, phase
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture


def errata_picture(parameters: Parameters | None = None) -> Picture:
    """Eq. (20) as a tangent of eq. (10), and eq. (17) against eq. (16) integrated twice."""
    paper = parameters or Parameters.defaults()
    figure, (kinetics, deflection) = new_figure(rows=2, height=6.4, shared=False)
    start = paper["wire.austenite_start_temperature"]
    finish = paper["wire.austenite_finish_temperature"]
    at, kelvin = 0.5 * (start + finish), np.linspace(start - 8.0, finish + 8.0, 400)
    here = float(phase.heated_fraction(at, 0.0, paper))
    kinetics.plot(
        kelvin, phase.heated_fraction(kelvin, 0.0, paper), color=MEASURED, lw=2, label="eq. (10)"
    )
    for slope, colour, label in (
        (linear.b1_as_printed, SECOND, "eq. (20) as printed"),
        (linear.b1, MODEL, "eq. (20) corrected"),
    ):
        line = here - float(slope(at, 0.0, paper)) * (kelvin - at)
        kinetics.plot(kelvin, line, "--", color=colour, label=label)
    kinetics.plot([at], [here], "o", color=FAINT, ms=5)
    kinetics.set(xlabel="temperature [K]", ylabel="martensite fraction ξ", ylim=(-0.15, 1.15))
    kinetics.legend(fontsize=8)
    beam = Beam.of(paper)
    strain = np.linspace(0.0, paper["wire.maximum_recoverable_strain"], 9)
    for law, style, colour, label in (
        (bending.deflection_as_printed, "--", SECOND, "eq. (17) as printed"),
        (bending.deflection, "-", MODEL, "eq. (17) corrected"),
    ):
        bent = [1e3 * law(float(e), beam) for e in strain]
        deflection.plot(100.0 * strain, bent, style, color=colour, label=label)
    twice = [1e3 * _integrated_twice(float(e), beam) for e in strain]
    deflection.plot(
        100.0 * strain, twice, "o", mfc="none", color=MEASURED, label="eq. (16) integrated twice"
    )
    deflection.set(xlabel="contraction of the active layer [%]", ylabel="deflection [mm]")
    deflection.legend(fontsize=8)
    caption = (
        "Errata 6 and 2: the tangent that eq. (20) is meant to be, at no stress and half of the "
        "transformation; and eq. (17). Data: none, evaluated from the equations with Table II and "
        "an assumed geometry."
    )
    return Picture("errata", "Two of the errata", caption, figure)


def _integrated_twice(strain: float, beam: Beam) -> float:
    x = np.linspace(0.0, beam.length, 401)
    slope = bending.curvature(strain, beam) * x
    return float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))

"""Heat of transformation.

    m c_p dT/dt = ... + m [dh + d (2 xi - 1)] dxi/dt

On heating the wire takes up dh, on cooling it gives it back; d: the first martensite to go takes
more than the last, as skewed peaks of calorimetry have it. Source: eq. (1), whose last term the
paper drops; Otsuka and Ren 2005. `core.heat` solves it together with the fractions, d at those of
the step's start.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "thermal",
    (Parameter("heat", "J/kg", 0.0,
               "Heat of transformation, the term of eq. (1) that the paper drops; 0 is off.",
               "assumed: 4 to 25 J/g by DSC", 0.0, 60e3, uncertainty=10e3),
     Parameter("tilt", "J/kg", 0.0, "d, how much more the first martensite to go takes; 0 is off.",
               "assumed: to half of dh", -30e3, 30e3, uncertainty=5e3)),
    shows="temperature lingers inside the transformation, up and down, and runs ahead of it "
    "afterwards",
    forms={"even": ("heat",), "skewed": ("heat", "tilt")},
    times={"heat": "wire.mass", "tilt": "wire.mass"}, constants=("LATENT_TILT",),
)


@borrowing
def latent_rise(wires, i):
    """K by which wire i would warm if its martensite formed at once as it does now."""
    return wires[i, at.LATENT_RISE] + wires[i, at.LATENT_TILT] * (2.0 * wires[i, at.FRACTION] - 1.0)

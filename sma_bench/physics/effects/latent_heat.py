"""Heat of transformation.

    m c_p dT/dt = ... + m [dh + d (2 xi - 1)] dxi/dt

On heating the wire takes up dh, on cooling it gives it back; d: the first martensite to go takes
more than the last, as skewed peaks of calorimetry have it. Source: eq. (1), whose last term the
paper drops; Otsuka and Ren 2005. `core.heat` solves it together with the fractions, d at those of
the step's start."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def latent_rise(wires, i):
    """K by which wire i would warm if its martensite formed at once as it does now."""
    return wires[i, at.LATENT_RISE] + wires[i, at.LATENT_TILT] * (2.0 * wires[i, at.FRACTION] - 1.0)

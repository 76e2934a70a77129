"""Heat of transformation.

    m c_p dT/dt = ... + m [dh + d (2 xi - 1)] dxi/dt

On heating the wire absorbs dh, on cooling it releases it. With d the first martensite to transform
absorbs more than the last, as skewed calorimetry peaks show; |d| counts up to dh, as none releases
heat on its way to austenite. Source: eq. (1), whose last term the paper drops; Otsuka and Ren 2005.
`core.heat` solves it together with the fractions, xi in the bracket from the step's start."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def latent_rise(wires, i):
    """K by which wire i would warm if its martensite formed at once, with the present bracket."""
    return wires[i, at.LATENT_RISE] + wires[i, at.LATENT_TILT] * (2.0 * wires[i, at.FRACTION] - 1.0)

"""Heat of transformation.

    m c_p dT/dt = ... + m dh dxi/dt

On heating the wire takes up dh, on cooling it gives it back. Source: eq. (1), whose last term the
paper drops; `core.heat` solves it together with the fractions.
"""

from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "latent_heat",
    "thermal",
    {"heat": at.LATENT_RISE},
    "temperature lingers inside the transformation, up and down, and runs ahead of it afterwards",
)

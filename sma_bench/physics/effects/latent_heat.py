"""Heat of transformation.

    m c_p dT/dt = ... + m dh dxi/dt

On heating the wire takes up dh, on cooling it gives it back. Source: eq. (1), whose last term the
paper drops; `core.heat` solves it together with the fractions.
"""

from sma_bench.parameters.parameter import Effect, Parameter

EFFECT = Effect(
    "thermal",
    (Parameter("heat", "J/kg", 0.0,
               "Heat of transformation, the term of eq. (1) that the paper drops; 0 is off.",
               "assumed: 4 to 25 J/g by DSC", 0.0, 60e3, uncertainty=10e3),),
    shows="temperature lingers inside the transformation, up and down, and runs ahead of it "
    "afterwards",
    times={"heat": "wire.mass"},
)

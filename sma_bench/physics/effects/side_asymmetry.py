"""Front and back differ in stiffness more than the parameters say.

    beta_front (1 + a) (1 + l),    beta_back (1 - a) (1 - l)
    alpha_front (1 + l),           alpha_back (1 - l)

Source: wires that do not lie alike in the matrix (the paper finds its two sides to differ); l: one
side nearer to the middle, where the same strain bends more and meets more stiffness, eq. (16).
`Boundary.of` applies it.
"""

from sma_bench.parameters.parameter import Effect, Parameter

EFFECT = Effect(
    "mechanical",
    (Parameter("ratio", "1", 0.0,
               "The front is stiffer and the back softer by this share; 0 is off.",
               "assumed: to 50 %", -0.9, 0.9, uncertainty=0.25),
     Parameter("lever", "1", 0.0,
               "The front bends more by the same strain, the back less, by this share; 0 is off.",
               "assumed: to 50 %", -0.9, 0.9, uncertainty=0.15)),
    forms={"stiffness": ("ratio",), "lever": ("lever",)},
    shows="one side's strokes are too large and the other's too small, at right temperatures",
    acts_on=("deflection",), loads=("beam",),
)

"""Front and back differ in stiffness more than the parameters say.

    beta_front (1 + a),    beta_back (1 - a)

Source: wires that do not lie alike in the matrix; the paper finds its two sides to differ.
`Boundary.bending` applies it.
"""

from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "side_asymmetry",
    "mechanical",
    {},
    "one side's strokes are too large and the other's too small, at right temperatures",
    ("deflection",),
)

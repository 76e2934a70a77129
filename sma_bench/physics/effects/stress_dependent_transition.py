"""Stress shifts the transformation otherwise than the parameters say.

    f, g at sigma (1/C_A + a), sigma (1/C_M + b),    each bracket 0 at least

Below 0 a wire that is held would transform in one snap, by its own stress.
Source: Clausius and Clapeyron, eqs. (10), (11) with C_A, C_M that are wrong, or absent.
"""

from sma_bench.parameters.parameter import Effect, Parameter

EFFECT = Effect(
    "transformation",
    (Parameter("austenite", "K/Pa", 0.0, "Added to 1/C_A; 0 is off.",
               "assumed: C of 5 to 15 MPa/K, wrong or absent", -2e-6, 2e-6, uncertainty=6e-8),
     Parameter("martensite", "K/Pa", 0.0, "Added to 1/C_M; 0 is off.",
               "assumed: C of 5 to 15 MPa/K, wrong or absent", -2e-6, 2e-6, uncertainty=6e-8)),
    shows="transformations come late or early in proportion to the load: where the beam is bent "
    "most",
    acts_on=("deflection",),
)

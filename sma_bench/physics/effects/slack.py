"""Wires that must contract a little before they pull.

    e - b = s where the wires are taut, 0 where they push (longer than at rest), and between the two
    they hang: no stress, the beam bends by itself (b: contraction that bends the beam)

Wires that a spring's preload or a weight draws straight at rest have none.
Source: a dead zone between wire and matrix (sleeves, crimps), in series with the wire.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "mechanical",
    (Parameter("strain", "1", 0.0, "Contraction that a wire takes up before it pulls; 0 is off.",
               "assumed: to 1 %", 0.0, 0.03, uncertainty=3e-3),),
    shows="deflection starts late and stops early in every stroke; small strokes are missing "
    "altogether",
    acts_on=("deflection",), loads=("beam", "spring"), marks=("PULLS_OTHERWISE",), row="side",
    columns={"strain": "SLACK"}, state=("TAUT",),
)


@borrowing
def contact(sides, side):
    """After a solution: 1 where the wires of a side are taut, 0 where they hang, -1 pushing."""
    free = -sides[side, at.BEAM_LOAD] / sides[side, at.BEAM_STIFFNESS]
    play = sides[side, at.CONTRACTION] - free
    taut = 0.0
    if play > sides[side, at.SLACK]:
        taut = 1.0
    elif play < 0.0:
        taut = -1.0
    # Wires that lose one contact hang first: the solution then says whether they have the other.
    return 0.0 if taut == -sides[side, at.TAUT] else taut

"""Wires that must contract a little before they pull.

With b the contraction that bends the beam, e - b = s if the wires are taut and 0 if they push
(longer than at rest); in between they hang slack, without stress.

Or they become taut gradually: with the contraction y beyond s

    b = y^2/(4 q) up to y = 2 q, y - q beyond

Or they rub in their sleeves: the play e - b, from 0 to s, stays constant while |sum sigma| <=
sigma_f, and slides at +- sigma_f.

Wires that a preload or a weight pulls straight at rest have no slack.
Source: a dead zone between wire and matrix (sleeves, crimps), in series with the wire; fibres of a
strand, or parts of a sleeve, that straighten evenly over 0 to 2 q (Lanir 1983); play with Coulomb
friction (Armstrong-Helouvry et al. 1994)."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

TOLERANCE = 1e-9  # contraction, tolerance of the linearised bending


@borrowing
def pulls(sides, side, contraction):
    """Bending of a side whose wires do not hang, and its slope in their contraction."""
    beyond = contraction
    if sides[side, at.RUBBING] > 0.0:
        beyond -= sides[side, at.PLAY_TAKEN]
    elif sides[side, at.SLACK] > 0.0 and sides[side, at.TAUT] > 0.0:
        beyond -= sides[side, at.SLACK]
    soft = sides[side, at.SOFT_SLACK]
    if soft <= 0.0 or beyond <= 0.0:
        return beyond, 1.0
    if beyond >= 2.0 * soft:
        return beyond - soft, 1.0
    return beyond * beyond / (4.0 * soft), beyond / (2.0 * soft)


@borrowing
def hangs(sides, side):
    """True if the play takes up all contraction: no stress except from rubbing."""
    if sides[side, at.RUBBING] > 0.0:
        return sides[side, at.SLIDES] != 0.0
    return sides[side, at.SLACK] > 0.0 and sides[side, at.TAUT] == 0.0


@borrowing
def hanging_bending(sides, side):
    """Bending of a side whose wires hang, or slide."""
    rubs = sides[side, at.SLIDES] * sides[side, at.RUBBING]
    return (rubs - sides[side, at.BEAM_LOAD]) / sides[side, at.BEAM_STIFFNESS]


@borrowing
def slide(sides, side):
    """After a solution: the direction in which rubbing wires slide, 0 where they stick."""
    here, taken = sides[side, at.CONTRACTION], sides[side, at.PLAY_TAKEN]
    slack, going = sides[side, at.SLACK], sides[side, at.SLIDES]
    if going != 0.0:
        play = here - hanging_bending(sides, side)
        if not 0.0 < play < slack:  # to the end of the play, where they stick
            sides[side, at.PLAY_TAKEN] = slack if going > 0.0 else 0.0
            return 0.0
        return going if (play - taken) * going >= 0.0 else 0.0
    bent = pulls(sides, side, here)[0]
    stress = sides[side, at.BEAM_STIFFNESS] * bent + sides[side, at.BEAM_LOAD]
    if stress > sides[side, at.RUBBING] and taken < slack:
        return 1.0
    return -1.0 if stress < -sides[side, at.RUBBING] and taken > 0.0 else 0.0


@borrowing
def linearise_bending(sides, side):
    """Linearise the bending about the present contraction, for the next solution."""
    here = sides[side, at.CONTRACTION]
    sides[side, at.PULLED_TO], sides[side, at.PULLED_SLOPE] = pulls(sides, side, here)
    sides[side, at.PULLED_FROM] = here


@borrowing
def linearised_too_far(sides, side):
    """After a solution: True if the linearised bending is too far off at the new contraction."""
    if sides[side, at.SOFT_SLACK] <= 0.0:
        return False
    here = sides[side, at.CONTRACTION]
    went = sides[side, at.PULLED_SLOPE] * (here - sides[side, at.PULLED_FROM])
    return abs(sides[side, at.PULLED_TO] + went - pulls(sides, side, here)[0]) > TOLERANCE


@borrowing
def contact(sides, side):
    """After a solution: 1 where the wires of a side are taut, 0 where they hang, -1 pushing."""
    free = -sides[side, at.BEAM_LOAD] / sides[side, at.BEAM_STIFFNESS]
    play = sides[side, at.CONTRACTION] - free
    taut = 1.0 if play > sides[side, at.SLACK] else 0.0
    taut = -1.0 if play < 0.0 else taut
    # Wires that lose one contact hang first: the solution then says whether they have the other.
    return 0.0 if taut == -sides[side, at.TAUT] else taut

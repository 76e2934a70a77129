# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""The passive side's wires resist the bending, and detwin.

    sum sigma_i = K e + k S (e - p),    |k S (e - p)| <= k n sigma_d,    S = sum of E_j(xi_j)

over the n wires j of the other side. Beyond sigma_d the martensite gives way: p follows, and stays
as a stretch until that side is heated, which recovers it: p falls with xi_j.
Source: ideal plasticity of twinned martensite in the beam's equilibrium.
"""

from sma_bench.compiled import compiled
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "opposing_wires",
    "mechanical",
    {"engagement": at.ENGAGEMENT, "detwinning_stress": at.DETWINNING_STRESS},
    "less deflection than one side alone would give, a rest deflection after large strokes, and a "
    "larger stroke of the other side when it is heated next",
    ("deflection",),
)


@compiled
def look_at_passive(wires, sides, side):
    """Note S and the limit k n sigma_d of the wires opposite; their recovery sets p back."""
    modulus, fraction, count = 0.0, 0.0, 0
    for j in range(wires.shape[0]):
        if int(wires[j, at.SIDE]) != side:
            xi = wires[j, at.FRACTION]
            modulus += wires[j, at.AUSTENITE_MODULUS] + xi * wires[j, at.MODULUS_CHANGE]
            fraction += xi
            count += 1
    if count > 0:
        fraction /= count
        before = sides[side, at.PASSIVE_FRACTION]
        if fraction < before:
            sides[side, at.DETWINNED] *= fraction / before
        sides[side, at.PASSIVE_FRACTION] = fraction
    sides[side, at.PASSIVE_MODULUS] = sides[side, at.ENGAGEMENT] * modulus
    limit = count * sides[side, at.DETWINNING_STRESS]
    sides[side, at.PASSIVE_LIMIT] = sides[side, at.ENGAGEMENT] * limit


@compiled
def yield_sign(sides, side, bent):
    """Sign of the yielding that fits a bending: 0 while the passive wires are elastic."""
    stiffness, limit = sides[side, at.PASSIVE_MODULUS], sides[side, at.PASSIVE_LIMIT]
    yielding = sides[side, at.YIELDING]
    if stiffness <= 0.0:
        return 0.0
    if yielding != 0.0:
        onward = bent - yielding * limit / stiffness - sides[side, at.DETWINNED]
        return yielding if onward * yielding >= 0.0 else 0.0
    reaction = stiffness * (bent - sides[side, at.DETWINNED])
    if abs(reaction) <= limit:
        return 0.0
    return 1.0 if reaction > 0.0 else -1.0


@compiled
def detwin(sides, side, bent):
    """After a step: p keeps the reaction of yielding wires at its limit."""
    if sides[side, at.YIELDING] != 0.0:
        reach = sides[side, at.PASSIVE_LIMIT] / sides[side, at.PASSIVE_MODULUS]
        sides[side, at.DETWINNED] = bent - sides[side, at.YIELDING] * reach

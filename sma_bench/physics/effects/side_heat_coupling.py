"""Heat through the matrix from one side's wires to the other's.

    m c_p dT_i/dt = ... - G (T_i - T_j),    T_j: mean of the wires opposite
    T_inf,i = T_inf + |p| (T_j - T_inf)     of a wire in the plume of the other side

If one side has more wires than the other, these share the G of the fewer. The plume reaches the
back if p > 0 and the front if p < 0.
Source: conduction between parallel wires in a slab, G' of 0.15 to 0.24 W/(m K) at 2 to 10 mm; free
convection from a wire below."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def set_opposite(wires):
    """Set for every wire the mean temperatures of the wires and the silicone opposite."""
    for i in range(wires.shape[0]):
        matrix, count = 0.0, 0
        for j in range(wires.shape[0]):
            if wires[j, at.SIDE] != wires[i, at.SIDE]:
                matrix += wires[j, at.MATRIX_RISE] + wires[j, at.AMBIENT]
                count += 1
        wires[i, at.OPPOSITE] = opposite_temperature(wires, i, 0.0)
        wires[i, at.OPPOSITE_MATRIX] = matrix / max(count, 1)


@borrowing
def opposite_temperature(wires, i, alone):
    """Mean temperature [K] of the wires opposite of wire i; `alone` where there are none."""
    sum_of, count = 0.0, 0
    for j in range(wires.shape[0]):
        if wires[j, at.SIDE] != wires[i, at.SIDE]:
            sum_of += wires[j, at.TEMPERATURE]
            count += 1
    return sum_of / count if count > 0 else alone


@borrowing
def in_plume(wires, i, air):
    """Temperature [K] of the air around wire i, which the wires opposite warm."""
    plume = wires[i, at.PLUME] if wires[i, at.SIDE] > 0.0 else -wires[i, at.PLUME]
    return air if plume <= 0.0 else air + plume * (opposite_temperature(wires, i, air) - air)

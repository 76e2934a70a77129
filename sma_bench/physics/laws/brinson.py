"""Brinson's law: the load determines which part of martensite is stress-induced and has a strain.

The fraction follows the contract's cosines, on heating shifted by sigma/C_A, on cooling only by
what lies above sigma_s (`wire.detwinning_start_stress`), max(sigma - sigma_s, 0)/C_M. It is the sum
of a stress-induced part (detwinned), which alone has the strain eps_L, and a temperature-induced
one (twinned). Of martensite that forms at sigma the share

    D = sin^2[pi/2 (sigma - sigma_s)/(sigma_f - sigma_s)]      0 below sigma_s, 1 above sigma_f

is stress-induced, or none while the existing martensite has a larger share than D. Under growing
stress existing martensite detwins up to the share D (above M_s: D at sigma - C_M (T - M_s)), and
stays detwinned. On heating both parts vanish in proportion (orientation.py).

Source: Brinson 1993, simplified: above M_s a wire at constant stress transforms over M_s - M_f, not
over (sigma_f - sigma_s)/C_M; a constant stress detwins nothing. Parameters: sigma_s, and sigma_f -
sigma_s (`wire.detwinning_stress_range`)."""

from sma_bench.compiled import inlined
from sma_bench.physics import columns as at
from sma_bench.physics.laws.cosine import ENDS, ramp  # noqa: F401 (the law's)


@inlined
def shifting(wires, i, stress):
    """Stress [Pa] that shifts the range of heating, its slope; the same for cooling."""
    above = stress - wires[i, at.ORIENTS_FROM]
    return (stress, 1.0, above, 1.0) if above > 0.0 else (stress, 1.0, 0.0, 0.0)


@inlined
def orients(wires, i, stress):
    """D of a wire, and its slope [1/Pa]."""
    oriented, slope = ramp((stress - wires[i, at.ORIENTS_FROM]) / wires[i, at.ORIENTS_WITHIN])
    return oriented, slope / wires[i, at.ORIENTS_WITHIN]

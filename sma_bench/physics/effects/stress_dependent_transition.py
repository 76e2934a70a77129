"""Stress shifts the transformation otherwise than the parameters say.

    f, g at sigma (1/C_A + a), sigma (1/C_M + b),    each bracket 0 at least

Below 0 a wire that is held would transform in one snap, by its own stress.
Source: Clausius and Clapeyron, eqs. (10), (11) with C_A, C_M that are wrong, or absent.
"""

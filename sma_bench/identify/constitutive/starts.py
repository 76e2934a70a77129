"""Where the joint fit starts, and between which bounds it searches."""

from collections.abc import Mapping, Sequence

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.constitutive.fit import Unknown, has_several_stresses
from sma_bench.identify.constitutive.law import REFERENCE_STRESS, Law, Loop
from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.strain_tangents import strain_tangents
from sma_bench.parameters import Parameters
from sma_bench.records.isobaric import STRONGEST
from sma_bench.records.thermal_cycles import Branch

_SLOPE_BOUNDS = (-5.0, 100.0)  # K per 100 MPa: C from 1 MPa/K on
_INFLUENCE = {"A": "wire.stress_influence_austenite", "M": "wire.stress_influence_martensite"}
_RELATIVE_EXPANSION = 3000.0  # 1e-6 of the strain's range per K


def unknowns_of(
    loops: Sequence[Loop], law: Law, parameters: Parameters
) -> tuple[list[Unknown], dict[str, float]]:
    """Unknowns with starts from the tangents, and what is fixed because the data cannot tell it.

    Raises:
        InputError: no loop shows a transformation.
    """
    read = _tangents(loops)
    several = has_several_stresses(loops)
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    slopes: Mapping[str, float] = {
        phase: REFERENCE_STRESS / parameters[name] for phase, name in _INFLUENCE.items()
    }
    if max(loop.stress for loop in loops) > STRONGEST:
        # A stress beyond belief must not shift anything: temperatures stay as measured.
        slopes = dict.fromkeys(slopes, 0.0)
    for phase, ends in (("A", ("A_s", "A_f")), ("M", ("M_f", "M_s"))):
        if ends[0] not in read:
            fixed.update(_unmeasured(phase, ends, law, slopes[phase], parameters))
            continue
        at_zero, slope = _line(read, ends, slopes[phase] if not several else None)
        for end, value in zip(ends, at_zero, strict=True):
            unknowns.append(Unknown(end, value, value - 80.0, value + 80.0, 4.0))
        names = [f"slope_{phase}"] if law == "contract" else [f"slope_{e}" for e in ends]
        for name in names:
            if several:
                start = float(np.clip(slope, 1.0, 90.0))
                unknowns.append(Unknown(name, start, *_SLOPE_BOUNDS, 2.0))
            else:
                fixed[name] = slope
    unknowns.extend(_strain_unknowns(loops, law, read["step"]))
    unknowns.extend(_expansion_unknowns(loops, law))
    if law == "extended":
        fixed["T_ref"] = float(np.mean(np.concatenate([loop.temperature for loop in loops])))
    if law == "extended" and _stresses(loops) >= 3:
        unknowns.append(Unknown("fading", 0.5, -20.0, 20.0, 0.5))
        phases = [phase for phase, end in (("A", "A_s"), ("M", "M_s")) if end in read]
        unknowns.extend(Unknown(f"bend_{phase}", 0.0, -30.0, 30.0, 0.5) for phase in phases)
    return unknowns, fixed


def _tangents(loops: Sequence[Loop]) -> dict[str, Array]:
    """(n, 2) stress in units of the reference and K for each end; `step` likewise in strain."""
    read: dict[str, list[tuple[float, float]]] = {}
    for loop in loops:
        branches = [
            Branch(
                "heating" if path.rising else "cooling",
                path.level, path.strain, np.full(len(path.strain), loop.stress),
            )
            for path in loop.paths
        ]
        for i, branch in enumerate(branches):
            companion = branches[1 - i] if len(branches) == 2 else None
            try:
                tangents = strain_tangents(branch, companion)
            except InputError:
                continue
            names = ("A_s", "A_f") if branch.direction == "heating" else ("M_s", "M_f")
            ends = tangents.cosine_ends()
            s = loop.stress / REFERENCE_STRESS
            for name, (value, _) in zip(names, ends, strict=True):
                read.setdefault(name, []).append((s, value))
            read.setdefault("step", []).append((s, tangents.step[0]))
    if not read:
        raise InputError("constitutive fit: no loop shows a transformation")
    return {name: np.array(points) for name, points in read.items()}


def _line(
    read: Mapping[str, Array], ends: tuple[str, str], slope: float | None
) -> tuple[list[float], float]:
    """Ends at zero stress and their common slope (fitted when not given)."""
    if slope is None:
        centred = [(p[:, 0] - p[:, 0].mean(), p[:, 1] - p[:, 1].mean()) for p in
                   (read[end] for end in ends)]
        power = sum(float(s @ s) for s, _ in centred)
        slope = sum(float(s @ t) for s, t in centred) / max(power, 1e-12)
    at_zero = [float(np.median(read[end][:, 1] - slope * read[end][:, 0])) for end in ends]
    if at_zero[1] - at_zero[0] < 1.0:
        at_zero[1] = at_zero[0] + 1.0
    return at_zero, slope


def _unmeasured(
    phase: str, ends: tuple[str, str], law: Law, slope: float, parameters: Parameters
) -> dict[str, float]:
    """A direction without a branch plays no part; any numbers will do."""
    words = {"A": "austenite", "M": "martensite"}[phase]
    kinds = {"s": "start", "f": "finish"}
    found = {e: parameters[f"wire.{words}_{kinds[e[-1]]}_temperature"] for e in ends}
    names = [f"slope_{phase}"] if law == "contract" else [f"slope_{e}" for e in ends]
    return {**found, **dict.fromkeys(names, slope)}


def _strain_unknowns(loops: Sequence[Loop], law: Law, step: Array) -> list[Unknown]:
    largest = max(float(np.max(np.abs(step[:, 1]))), 1e-4)
    top = max(3.0 * largest, 3.0 * max(loop.recovered for loop in loops))
    if law == "contract" or _stresses(loops) < 3:
        return [Unknown("eps_L", largest, 0.0, top, 0.1 * largest)]
    least = max(float(np.min(np.abs(step[:, 1]))), 1e-6)
    return [
        Unknown("H_min", 0.5 * least, 0.0, top, 0.1 * largest),
        Unknown("dH", largest, 0.0, top, 0.1 * largest),
        Unknown("k", 1.0, 0.01, 30.0, 0.3),
    ]


def _stresses(loops: Sequence[Loop]) -> int:
    return len(np.unique(np.round([loop.stress / 2e6 for loop in loops])))


def _expansion_unknowns(loops: Sequence[Loop], law: Law) -> list[Unknown]:
    if loops[0].is_relative:
        limit, size = _RELATIVE_EXPANSION * 10.0, _RELATIVE_EXPANSION
    else:
        limit, size = 200.0, 5.0
    if law == "contract":
        return [Unknown("Theta_T", -0.2, -50.0, 50.0, 0.2)] if not loops[0].is_relative else [
            Unknown("Theta_T", 0.0, -1e4, 1e4, 10.0)
        ]
    start = 0.0 if loops[0].is_relative else 8.0
    return [Unknown(name, start, -limit, limit, size) for name in ("alpha_A", "alpha_M")]

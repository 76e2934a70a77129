"""Which pictures belong to which experiment."""

from collections.abc import Callable

from sma_bench.identify.estimate import Experiment
from sma_bench.report.alloy_figures import (
    bench_fit_pictures,
    constitutive_picture,
    isobaric_pictures,
    tensile_picture,
    thermal_expansion_picture,
)
from sma_bench.report.page import Picture
from sma_bench.report.thermal_figures import (
    dsc_pictures,
    heat_transfer_picture,
    ramp_picture,
    resistance_picture,
    slope_picture,
)

_PICTURES: dict[str, Callable[[Experiment], list[Picture]]] = {
    "E1": lambda e1: [resistance_picture(e1)],
    "E2": lambda e2: [heat_transfer_picture(e2)],
    "E3": lambda e3: [ramp_picture(e3), slope_picture(e3)],
    "E5": dsc_pictures,
    "E6": isobaric_pictures,
    "E7": lambda e7: [tensile_picture(e7)],
    "E8": lambda e8: [thermal_expansion_picture(e8)],
    "E9": lambda e9: _load_frame_pictures(e9),
    "E10": bench_fit_pictures,
}


def _load_frame_pictures(e9: Experiment) -> list[Picture]:
    """Loops of isobaric tests, or the signals of the load frame's bags."""
    has_loops = any(name.endswith("/model") for name in e9.curves)
    return [constitutive_picture(e9)] if has_loops else bench_fit_pictures(e9)


def experiment_pictures(experiment: Experiment) -> list[Picture]:
    """Pictures of one identified experiment, drawn from its curves."""
    draw = _PICTURES.get(experiment.name)
    return draw(experiment) if draw else []

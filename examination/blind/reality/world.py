"""A world: the true numbers of a rig, and every departure from the baseline model.

All departures off is the baseline. `Features` are what may happen, a `World` is one bench."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind

# --- Every departure of the reality from the baseline model; all of them off is the baseline.
#
# A setting only shapes another feature and does nothing alone. What is `outside` is in no list of
# effects that a diagnosis could know. Sensor features are carried here so that a world is one
# table; they act where the signals are measured, not in the simulation.


@dataclass(frozen=True)
class Feature:
    """One departure from the baseline.

    Attributes:
        name, unit: as in a world's features.
        off: value at which it does nothing (for a setting: its usual value).
        low, high: what is accepted; realistic sizes lie well within.
        text: what it does.
        stage: electrical, thermal, transformation, mechanical or sensor.
        outside: belongs to no effect of the contract.
        setting: only shapes another feature.
    """

    name: str
    unit: str
    off: float
    low: float
    high: float
    text: str
    stage: str = ""
    outside: bool = False
    setting: bool = False


def _stage(stage: str, *features: Feature) -> tuple[Feature, ...]:
    return tuple(replace(feature, stage=stage) for feature in features)


ELECTRICAL = _stage(
    "electrical",
    Feature(
        "resistance_austenite_change", "1", 0.0, -0.5, 0.5,
        "Relative change of a wire's resistance from martensite to austenite.",
    ),
    Feature(
        "resistance_temperature_coefficient", "1/K", 0.0, -5e-3, 5e-3,
        "Relative change of a wire's resistance per kelvin above the ambient of the start.",
    ),
    Feature(
        "supply_resistance", "ohm", 0.0, 0.0, 5.0,
        "Leads between the driver, where the voltage is read, and each wire.",
    ),
    Feature(
        "current_limit", "A", 0.0, 0.0, 100.0,
        "Largest current of a driver; the voltage reading stays at its set point. 0 is none.",
        outside=True,
    ),
    Feature(
        "contact_growth", "ohm/min", 0.0, 0.0, 5.0,
        "A wire's contact resistance grows with the time it is driven.",
        outside=True,
    ),
)

THERMAL = _stage(
    "thermal",
    Feature(
        "latent_heat", "J/kg", 0.0, 0.0, 60e3,
        "Heat that a kilogram takes in on its way from martensite to austenite.",
    ),
    Feature(
        "convection_by_correlation", "1", 0.0, 0.0, 2.0,
        "How far the film at the surface follows free convection and radiation (1: wholly).",
    ),
    Feature(
        "silicone_heat_capacity", "J/K", 0.0, 0.0, 20.0,
        "Of the silicone skin between one wire and the air, as a field across the thickness; "
        "between the sides there is as much again for each wire.",
    ),
    Feature(
        "silicone_share", "1", 0.5, 0.05, 0.95,
        "Part of the thermal resistance from wire to air that lies in the silicone.",
        setting=True,
    ),
    Feature(
        "side_conductance", "W/K", 0.0, 0.0, 0.5,
        "From a front wire through the matrix to the back wire behind it.",
    ),
    Feature(
        "ambient_rate", "K/s", 0.0, -0.05, 0.05,
        "The room warms steadily.",
    ),
    Feature(
        "ambient_wave", "K", 0.0, -10.0, 10.0,
        "Amplitude of a slow wave (three minutes) of the room's temperature.",
    ),
    Feature(
        "draught", "1", 0.0, 0.0, 5.0,
        "Gusts at irregular intervals: relative rise of the film's conductance.",
        outside=True,
    ),
    Feature(
        "draught_seed", "1", 0.0, 0.0, 2.0**31, "Which gusts.",
        setting=True,
    ),
)

TRANSFORMATION = _stage(
    "transformation",
    Feature(
        "grain_spread", "K", 0.0, 0.0, 15.0,
        "Standard deviation of the transition temperatures over the grains of a wire.",
    ),
    Feature(
        "kinetics_smoothness", "1", 0.0, 0.0, 1.0,
        "From cosine ramps (0) to error functions of the same mean and width (1).",
    ),
    Feature(
        "return_point_memory", "1", 0.0, 0.0, 1.0,
        "From the proportional rule of incomplete loops (0) to loops that close where they "
        "were opened (1).",
    ),
    Feature(
        "transition_drift", "K", 0.0, -20.0, 20.0,
        "Shift of all transition temperatures after many loops.",
    ),
    Feature(
        "drift_cycles", "1", 3.0, 0.1, 1000.0,
        "Full loops after which drift and plastic strain have reached 63 %.",
        setting=True,
    ),
    Feature(
        "plastic_strain", "1", 0.0, -0.01, 0.01,
        "Elongation that stays in a wire after many loops.",
    ),
    Feature(
        "stress_influence_factor_austenite", "1", 1.0, 0.0, 4.0,
        "Multiplies 1/C_A.",
    ),
    Feature(
        "stress_influence_factor_martensite", "1", 1.0, 0.0, 4.0,
        "Multiplies 1/C_M.",
    ),
    Feature(
        "r_phase", "1", 0.0, 0.0, 1.0,
        "Share of the strain that transforms in a stage of its own, by way of the R-phase.",
        outside=True,
    ),
    Feature(
        "transformation_lag", "s", 0.0, 0.0, 20.0,
        "Time constant with which the phase follows temperature and stress.",
        outside=True,
    ),
)

MECHANICAL = _stage(
    "mechanical",
    Feature(
        "unrecovered_strain", "1", 0.0, 0.0, 0.9,
        "Share of the largest contraction so far that stays when the wire is cold again.",
    ),
    Feature(
        "matrix_relaxation", "1", 0.0, 0.0, 0.9,
        "Share of the silicone's stiffness that relaxes.",
    ),
    Feature(
        "relaxation_time", "s", 20.0, 0.05, 2000.0,
        "Geometric mean of the two relaxation times, which are a decade apart.",
        setting=True,
    ),
    Feature(
        "opposing", "1", 0.0, 0.0, 1.0,
        "How far the sides act on one beam (1: contraction of one stretches the other fully).",
    ),
    Feature(
        "detwinning_stress", "Pa", 100e6, 1e6, 1e9,
        "Stress at which stretched martensite yields.",
        setting=True,
    ),
    Feature(
        "stiffness_asymmetry", "1", 0.0, -0.9, 0.9,
        "The beam is stiffer by this towards the front, softer by it towards the back.",
    ),
    Feature(
        "slack", "1", 0.0, 0.0, 0.03,
        "Strain that a wire takes up before it pulls.",
    ),
    Feature(
        "friction", "m", 0.0, 0.0, 0.02,
        "Dry friction of the beam: the tip stays behind by so much, either way.",
        outside=True,
    ),
    Feature(
        "stiffening", "1/m2", 0.0, 0.0, 1e6,
        "The beam's stiffness grows with the square of the deflection.",
        outside=True,
    ),
    Feature(
        "clamp_slip", "m", 0.0, -0.05, 0.05,
        "The beam turns in its clamp at one instant and stays so.",
        outside=True,
    ),
    Feature(
        "clamp_slip_time", "s", 60.0, 0.0, 1e5, "That instant.",
        setting=True,
    ),
)

SENSOR = _stage(
    "sensor",
    Feature(
        "spot_fill", "1", 1.0, 0.05, 1.0,
        "Part of the infrared spot that the wire fills.",
    ),
    Feature(
        "camera_lag", "s", 0.0, 0.0, 20.0,
        "Time constant of the temperature reading.",
    ),
    Feature(
        "deflection_drift", "m", 0.0, -0.05, 0.05,
        "Slow offset of the deflection over the record.",
    ),
    Feature(
        "sensor_nonlinearity", "1/m", 0.0, -50.0, 50.0,
        "Triangulation: quadratic error of the deflection.",
        outside=True,
    ),
    Feature(
        "pickup", "m/A", 0.0, -0.05, 0.05,
        "The deflection sensor picks up the current.",
        outside=True,
    ),
    Feature(
        "shutter_steps", "K", 0.0, 0.0, 20.0,
        "The camera's offset jumps when its shutter calibrates it.",
        outside=True,
    ),
)

FEATURES: tuple[Feature, ...] = (
    *ELECTRICAL, *THERMAL, *TRANSFORMATION, *MECHANICAL, *SENSOR
)
BY_NAME: dict[str, Feature] = {feature.name: feature for feature in FEATURES}


# --- A world: the true numbers of a rig, and what the baseline model does not know of it.

_BENDING = (
    "composite.deflection_per_strain",
    "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
)


@dataclass(frozen=True, eq=False)
class World:
    """One bench as it really is: a composite, or wires with a load.

    Attributes:
        parameters: true numbers of the baseline; of a composite both sides have equally many wires
            and the bending coefficients are given; a weight or a spring has wires on one side.
        features: values by name of FEATURES; what is absent is off.

    Raises:
        InputError: an unknown feature, a value out of its range, or a rig that is no composite.
    """

    parameters: Parameters
    features: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "features", {name: _checked(name, v) for name, v in self.features.items()}
        )
        sides = self.sides
        front, back = sides.count("front"), sides.count("back")
        if self.load == "antagonist" and not (
            self.parameters["load.stiffness"] > 0.0 == self.parameters["load.force"]
        ):
            raise InputError("world: antagonists without load.stiffness, or with load.force")
        if self.load != "beam":
            return
        if front != back:
            raise InputError(
                f"world: {front} wires in front and {back} behind, expected equally many"
            )
        for name in _BENDING:
            if not self.parameters[name] > 0.0:
                raise InputError(f"world: {name} is not given, expected a value above 0")

    @property
    def load(self) -> str:
        """`load.kind`."""
        kind = load_kind(self.parameters)
        if kind == "clamped":
            raise InputError("world: load.kind is clamped, expected one that moves")
        return kind

    @property
    def sides(self) -> tuple[str, ...]:
        """Of all wires; those of a weight or a spring have others behind them that do nothing."""
        sides = tuple(self.parameters["bench.channel_sides"])
        return sides if self.load in ("beam", "antagonist") else sides + ("back",) * len(sides)

    def feature(self, name: str) -> float:
        """Value of a feature; its `off` where the world does not name it."""
        if name not in BY_NAME:
            raise InputError(f"world: no feature {name}, expected one of FEATURES")
        return self.features.get(name, BY_NAME[name].off)


def _checked(name: str, value: float) -> float:
    if name not in BY_NAME:
        raise InputError(f"world: no feature {name}, expected one of FEATURES")
    feature = BY_NAME[name]
    number = float(value)
    if not math.isfinite(number) or not feature.low <= number <= feature.high:
        raise InputError(
            f"world: {name} is {value!r}, "
            f"expected {feature.low:g} to {feature.high:g} {feature.unit}"
        )
    return number

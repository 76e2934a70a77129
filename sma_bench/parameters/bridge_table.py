"""Parameters of the node between ROS and the bench's Uno (serial_bridge)."""

from sma_bench.parameters.parameter import MANAGED, Parameter

# Sharp GP2Y0A41SK0F, from its datasheet's curve: V = 0.124 V m/(d + 4.2 mm) + 0.03 V.
_RANGE_SLOPE, _RANGE_SHIFT, _RANGE_LEVEL = 0.124, 4.2e-3, 0.03
_NOMINAL = "nominal: firmware/config.h; sma-bench calibrate"
_SIDES = ("front", "back")


# Beyond it a sensor is broken, another one, or mounted the wrong way round.
_GAINS = (0.5, 2.0)
_MOST_OFFSET = 2.0


def _line(sensor: str, unit: str, what: str) -> tuple[Parameter, Parameter]:
    name = f"calibration.{sensor}"
    return (
        Parameter(
            f"{name}.gain", "1", 1.0, f"True {what} over the device's reading.",
            _NOMINAL, *_GAINS,
        ),
        Parameter(
            f"{name}.offset", unit, 0.0, f"True {what} where the device reads zero.",
            _NOMINAL, -_MOST_OFFSET, _MOST_OFFSET,
        ),
    )


def _range(side: str) -> tuple[Parameter, ...]:
    name = f"calibration.{side}_range"
    source = "assumed: Sharp GP2Y0A41SK0F; sma-bench calibrate"
    return (
        Parameter(
            f"{name}.gain", "1/(V m)", round(1.0 / _RANGE_SLOPE, 4),
            "Distance = 1/(gain voltage + offset) - shift.", source, 0.5, 50.0,
        ),
        Parameter(
            f"{name}.offset", "1/m", round(-_RANGE_LEVEL / _RANGE_SLOPE, 4),
            "See the gain.", source, -20.0, 20.0,
        ),
        Parameter(
            f"{name}.shift", "m", _RANGE_SHIFT, "Depth of the lens behind the sensor's face.",
            source, -0.1, 0.1,
        ),
        Parameter(
            f"range.{side}_standoff", "m", 0.1,
            f"Distance that the {side} sensor reads with the undeflected tip.",
            "assumed: middle of a 40 to 300 mm triangulation sensor", 0.01, 1.0,
        ),
    )


SERIAL_BRIDGE = (
    MANAGED,
    Parameter(
        "port", "", "",
        "Serial port of the Uno, by its stable name; empty for the only one in "
        "/dev/serial/by-id.",
        "choice", kind="string",
    ),
    Parameter(
        "telemetry_rate", "Hz", 100, "Rate of the readings, a divisor of 1000, up to 500.",
        "choice: the simulator's", 1, 500, kind="integer",
    ),
    Parameter(
        "feedback", "", ("power", "temperature"),
        "Readings that every channel must keep sending, else the outputs go to 0 V.",
        "choice: both; a rig without a camera has power only", kind="strings",
    ),
    Parameter(
        "feedback_timeout", "s", 1.0,
        "Age at which a reading is stale, and a disagreement with the model a fault.",
        "choice: five time constants of the wire", 0.05, 60.0,
    ),
    Parameter(
        "self_test_waived", "", "",
        "Why outputs may be enabled without a self-test; empty to demand one, which enabling runs.",
        "choice: a self-test", kind="string",
    ),
    Parameter(
        "range.sensors", "", _SIDES,
        "Mounted triangulation sensors of a composite rig.", "choice", kind="strings",
    ),
    *_line("supply", "V", "supply voltage"),
    *(p for side in _SIDES for p in _line(f"{side}_current", "A", f"current of the {side} board")),
    *(p for side in _SIDES for p in _range(side)),
)

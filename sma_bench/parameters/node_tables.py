"""Each node's own parameters, beside the contract's (table.py)."""

from sma_bench.parameters.parameter import Parameter, fixed
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.table import BY_NAME

# --- The node between ROS and the bench's Uno (serial_bridge).

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


# --- The infrared camera, and the synthetic camera that stands in for it.

# What both have to agree on.
_SCENE = fixed(
    Parameter(
        "image_width", "px", 382, "Columns of thermal_image.", "Optris Xi 400", 32, 4096,
        kind="integer",
    ),
    Parameter(
        "image_height", "px", 288, "Rows of thermal_image.", "Optris Xi 400", 32, 4096,
        kind="integer",
    ),
    Parameter(
        "pixel_size", "m", 0.4e-3, "Size of a pixel at the wire: 17 um times distance over focal "
        "length.",
        "assumed: Xi 400 with the lens of 12.7 mm (29 degrees) at 0.3 m", 1e-6, 0.1,
    ),
    Parameter(
        "emissivity", "1", 0.95, "Emissivity of the wires in the camera's band.",
        "assumed: wire painted matt black; bare wire reads far too low with it, see docs/camera.md",
        0.05, 1.0,
    ),
    Parameter(
        "reflected_temperature", "K", 0.0,
        "Temperature of the surroundings that the wires mirror; 0 for "
        "environment.ambient_temperature.",
        "choice", 0.0, 1000.0,
    ),
)

IR_CAMERA = fixed(
    *_SCENE,
    Parameter(
        "regions", "", ("",),
        "One a channel: 'X Y WIDTH HEIGHT', upper left corner and size in pixels of the part of "
        "the picture that its wire stays in, then x or y if the wire does not run along the longer "
        "side; empty, with one channel, for the whole picture.",
        "choice", kind="strings",
    ),
    Parameter(
        "statistic", "", "median",
        "Over the wire's length: mean, median, or hottest (a sixth of a dozen lines; reads high "
        "by twice its noise).",
        "choice: a median passes over clamps and hot spots", kind="string",
    ),
    Parameter(
        "correct_fill", "", True,
        "Correct for a wire that does not fill its pixels; false takes the wire's middle pixel, "
        "for wires of five pixels or more.",
        "choice", kind="bool",
    ),
    Parameter(
        "pixel_size_std", "m", 8e-6, "Standard deviation of pixel_size.",
        "assumed: 2 %, a scale of 50 mm in the picture read to a millimetre", 0.0, 0.1,
    ),
    Parameter(
        "emissivity_std", "1", 0.02, "Standard deviation of emissivity.", "assumed", 0.0, 1.0,
    ),
    Parameter(
        "reflected_temperature_std", "K", 2.0, "Standard deviation of reflected_temperature.",
        "assumed", 0.0, 500.0,
    ),
    Parameter(
        "camera_accuracy", "K", 1.2,
        "Standard deviation of the camera's calibration, common to all pixels.",
        "Optris Xi 400: 2 K or 2 %, as the limits of a rectangle", 0.0, 100.0,
    ),
    Parameter(
        "camera_lowest", "K", 253.15, "Lower end of the camera's measuring range.",
        "Optris Xi 400: -20 degC; its 0 to 250 degC range shows colder as that", 173.15, 2000.0,
    ),
    Parameter(
        "camera_highest", "K", 523.15, "Upper end of the camera's measuring range.",
        "Optris Xi 400: 250 degC", 273.15, 3000.0,
    ),
    Parameter(
        "least_visible", "1", 0.5,
        "Share of its region's length in which a wire must be seen to be read.", "choice",
        0.1, 1.0,
    ),
    Parameter(
        "read_cold_wires", "", False,
        "Read wires that are not warmer than their background too: a dark line as a wire, and "
        "nothing to be seen as the background's temperature, with half of what could just be seen "
        "as deviation. Needs <channel>/power to notice a heated wire that is not there.",
        "choice: nothing is read that is not seen", kind="bool",
    ),
    Parameter(
        "stale_limit", "s", 0.25, "Age at which a frame is held back, and silence an error.",
        "choice: twenty frames", 0.01, 10.0,
    ),
    Parameter(
        "shutter_spread", "K", 1.0,
        "A frame whose warmest and coldest pixels differ by less shows the camera's shutter; 0 "
        "for never.",
        "assumed: noise of 80 mK spreads over 0.7 K", 0.0, 100.0,
    ),
    Parameter(
        "shutter_settle", "s", 0.1, "Time after the shutter in which frames are held back.",
        "assumed", 0.0, 10.0,
    ),
)

SYNTHETIC_CAMERA = (
    *_SCENE,
    *fixed(
        Parameter(
            "rate", "Hz", 80.0, "Rate of thermal_image.", "Optris Xi 400, 80 Hz", 1.0, 200.0,
        ),
        Parameter(
            "wires", "", ("",),
            "One a channel: 'X0 Y0 X1 Y1' in pixels, from the clamped end to the one that moves; "
            "empty for wires side by side across the whole picture.",
            "choice", kind="strings",
        ),
        Parameter(
            "background", "K", 0.0,
            "Apparent temperature behind the wires; 0 for environment.ambient_temperature.",
            "choice", 0.0, 1000.0,
        ),
        Parameter(
            "unevenness", "K", 3.0, "How much warmer the background's lower right corner is.",
            "assumed: a room is never of one temperature", 0.0, 100.0,
        ),
        Parameter(
            "blur", "px", 0.7, "Standard deviation of the lens's blur.",
            "assumed: 90 % of an edge within three pixels", 0.0, 5.0,
        ),
        Parameter(
            "noise", "K", 0.08, "Standard deviation of every pixel.", "Optris Xi 400: 80 mK",
            0.0, 10.0,
        ),
        Parameter(
            "sway", "px", 3.0, "Amplitude of a slow sideways movement of the wires' free ends.",
            "choice: a wire in air is never still", 0.0, 100.0,
        ),
        Parameter(
            "seed", "", 1, "Seed of the noise.", "choice", 0, 2**31 - 1, kind="integer",
        ),
    ),
    Parameter(
        "fault", "", "none",
        "What goes wrong: none, frozen (the last picture with new stamps), shutter (a uniform "
        "surface), silent (no pictures), moved (the wires are out of the picture).",
        "for tests", kind="string",
    ),
)


# --- The twin.

TWIN = (
    Parameter(
        "publish_rate", "Hz", 100.0,
        "Highest rate of each topic below twin/; all readings are compared, however many are "
        "published.",
        "choice: the rate of an Uno's readings", 0.1, 1000.0, read_only=True,
    ),
    Parameter(
        "voltage_timeout", "s", 0.5,
        "A longer hole in the voltages hides what drove the bench: the twin begins anew.",
        "choice: the default command timeout", 0.02, 60.0, read_only=True,
    ),
    Parameter(
        "window", "s", 10.0, "Time that a verdict looks back.",
        "choice: some time constants of a wire in silicone", 2.0, 60.0,
    ),
    Parameter(
        "learning", "s", 5.0, "Readings that a signal must have given before it is judged.",
        "choice: 25 bins, enough to estimate a noise", 2.0, 60.0,
    ),
    Parameter(
        "threshold", "1", 2.0,
        "Root mean square residual over the noise of a sample from which on there is a gap.",
        "choice: as the withheld-effect check counts gaps", 1.0, 100.0,
    ),
    Parameter(
        "allowed.current", "A", 0.01, "Slow drift that a current sensor may have.",
        "assumed: as the diagnosis does", 0.0, 10.0,
    ),
    Parameter(
        "allowed.temperature", "K", 0.5, "Slow drift that a thermometer may have.",
        "assumed: as the diagnosis does", 0.0, 100.0,
    ),
    Parameter(
        "allowed.deflection", "m", 5e-5, "Slow drift that the deflection's zero may have.",
        "assumed: as the diagnosis does", 0.0, 0.1,
    ),
    Parameter(
        "allowed.force", "N", 0.1, "Slow drift that a load cell may have.",
        "assumed: 0.2 % of a 50 N load cell", 0.0, 100.0,
    ),
)


# --- The simulated bench, experiments, records, services and controllers.

_ADC_10_BIT = 1023

COMMAND_RATE = Parameter(
    "command_rate", "Hz", 20.0,
    "Rate of voltage_command, and of /clock above real time: one command for each tick.",
    "choice: ten commands within the default command timeout", 2.0, 500.0, read_only=True,
)

REQUIRE_RECORDER = Parameter(
    "require_recorder", "", False,
    "Start, and go on, only while the recorder of the namespace hears every topic.",
    "choice: set by the launch files where they start one", kind="bool", read_only=True,
)

SIMULATOR = fixed(
    Parameter(
        "speed", "1", 1.0,
        "Simulated seconds per second; above 1 the node publishes /clock and other nodes need "
        "use_sim_time.",
        "choice", 1.0, 1000.0,
    ),
    Parameter(
        "seed", "", 1, "Seed of the sensor noise.", "choice", 0, 2**31 - 1, kind="integer",
    ),
    Parameter(
        "lockstep_patience", "s", 5.0,
        "Wall time that simulated time waits for the next command of an active driver.",
        "choice: far above the pauses of a loaded machine", 0.01, 60.0,
    ),
    COMMAND_RATE,
    Parameter(
        "rate.power", "Hz", 100.0, "Rate of <channel>/power.",
        "assumed: an Uno reads six channels at 10 kHz in all", 1.0, 1000.0,
    ),
    Parameter(
        "rate.temperature", "Hz", 80.0, "Rate of <channel>/temperature.",
        "Optris Xi 400, 80 Hz", 1.0, 1000.0,
    ),
    Parameter(
        "rate.mechanics", "Hz", 100.0, "Rate of joint_states and of the range sensors.",
        "assumed: read together with the power channels", 1.0, 1000.0,
    ),
    Parameter(
        "rate.ambient", "Hz", 1.0, "Rate of ambient/temperature.", "choice", 0.1, 100.0,
    ),
    Parameter(
        "sensor.voltage_noise", "V", 0.002, "Standard deviation of the measured voltage.",
        "assumed: half the least significant bit of a quiet divider", 0.0, 10.0,
    ),
    Parameter(
        "sensor.voltage_resolution", "V", 10.0 / _ADC_10_BIT,
        "Step of the measured voltage; 0 for none.",
        "ATmega328: 10 bit over 10 V", 0.0, 10.0,
    ),
    Parameter(
        "sensor.current_noise", "A", 0.019, "Standard deviation of the measured current.",
        "ACS714 -05B datasheet: 21 mV peak to peak at 185 mV/A, over 6", 0.0, 10.0,
    ),
    Parameter(
        "sensor.current_resolution", "A", 5.0 / _ADC_10_BIT / 0.185,
        "Step of the measured current; 0 for none.",
        "ACS714 -05B, 185 mV/A, on 10 bit over 5 V", 0.0, 10.0,
    ),
    Parameter(
        "sensor.temperature_noise", "K", 0.08, "Standard deviation of the measured temperature.",
        "Optris Xi 400: 80 mK", 0.0, 50.0,
    ),
    Parameter(
        "sensor.temperature_resolution", "K", 0.1,
        "Step of the measured temperature; 0 for none.",
        "Optris image format, 0.1 degC", 0.0, 50.0,
    ),
    Parameter(
        "sensor.range_standoff", "m", 0.1,
        "Distance from each range sensor to the undeflected tip.",
        "assumed: middle of a 40 to 300 mm triangulation sensor", 0.01, 1.0,
    ),
    Parameter(
        "sensor.range_noise", "m", 1e-4, "Standard deviation of a measured distance.",
        "assumed: 0.1 % of the distance", 0.0, 0.1,
    ),
    Parameter(
        "sensor.range_resolution", "m", 1e-4, "Step of a measured distance; 0 for none.",
        "assumed: as its noise", 0.0, 0.1,
    ),
    Parameter(
        "sensor.force_noise", "N", 0.02, "Standard deviation of the measured wire force.",
        "assumed: 0.05 % of a 50 N load cell", 0.0, 10.0,
    ),
)

EXPERIMENT = (
    Parameter(
        "protocol", "", "staircase",
        "Protocol to run: a name in config/protocols or the path of a .yaml file.",
        "choice", kind="string",
    ),
    Parameter(
        "protocol_root", "", "",
        "Folder below which a file must lie that is named while the node runs; empty for where the "
        "node was started.",
        "choice", kind="string", read_only=True,
    ),
    Parameter(
        "autostart", "", False, "Start as soon as the bench answers.", "choice", kind="bool",
        read_only=True,
    ),
    REQUIRE_RECORDER,
    COMMAND_RATE,
    Parameter(
        "feedback", "", ("power", "temperature"),
        "Readings that every channel must keep sending, else the experiment aborts.",
        "choice: both; a rig without a camera has power only", kind="strings", read_only=True,
    ),
    Parameter(
        "feedback_timeout", "s", 1.0, "Age at which a reading is stale.",
        "choice: five time constants of the wire", 0.05, 60.0, read_only=True,
    ),
)

RECORDER = fixed(
    Parameter(
        "output", "", "",
        "Folder of the new bag, which must not exist; empty for record_<date>_<time>. Later bags "
        "of the same recorder end in _2, _3, ...",
        "choice", kind="string",
    ),
    Parameter(
        "skip_idle", "", False,
        "Leave out what comes while no experiment and no controller runs.", "choice", kind="bool",
    ),
    Parameter(
        "idle_margin", "s", 10.0, "What is kept before and after a run all the same.",
        "choice: a wire in silicone cools within it", 0.0, 600.0,
    ),
)

# Any program that finds the node may set its parameters and call its service.
_ROOTS = fixed(
    Parameter(
        "record_root", "", "",
        "Folder that records must lie in; empty for the one the node is started in, / for any.",
        "choice", kind="string",
    ),
    Parameter(
        "output_root", "", "",
        "Folder that results are written below; empty for sma_bench_results where the node is "
        "started, / for any.",
        "choice", kind="string",
    ),
)

IDENTIFICATION = (
    Parameter(
        "record", "", ("",),
        "Bags and instrument files to identify from, relative to record_root.",
        "choice", kind="strings",
    ),
    Parameter(
        "experiments", "", ("",), "Experiments to run (E1, E2, ...); empty for all that apply.",
        "choice", kind="strings",
    ),
    *_ROOTS,
    Parameter(
        "output_directory", "", "identified",
        "Folder for identified.yaml and identified.json.",
        "choice", kind="string",
    ),
)

DIAGNOSIS = (
    Parameter(
        "record", "", ("",), "Bags of one bench to diagnose, relative to record_root.",
        "choice", kind="strings",
    ),
    Parameter(
        "hold_out", "", ("",),
        "Further bags, relative to record_root, on which the shrinkage is measured; empty for the "
        "last part of each record.",
        "choice", kind="strings",
    ),
    *_ROOTS,
    Parameter(
        "improved", "", "", "Parameter file (.yaml) to write with the improvement; empty for none.",
        "choice", kind="string",
    ),
    Parameter(
        "report", "", "", "Folder for a page with figures; empty for none.",
        "choice", kind="string",
    ),
)

INVESTIGATION = (
    Parameter(
        "record", "", ("",), "Bags that there are already, relative to record_root.",
        "choice", kind="strings",
    ),
    Parameter(
        "folder", "", "investigation",
        "Records, diagnoses and the story, below output_root; the same folder goes on where it "
        "was stopped. The experiment node must take protocols from there (its protocol_root).",
        "choice", kind="string",
    ),
    *_ROOTS,
    Parameter(
        "budget", "min", 30.0, "Time that the bench may be driven in all.", "choice", 0.0, 1e4,
    ),
    Parameter(
        "confirm", "", True, "Wait for ~/confirm before every run.",
        "choice: wires get hot", kind="bool",
    ),
    Parameter(
        "signals", "", ("",),
        "Compare these only, of current, temperature, deflection; empty for all.",
        "choice", kind="strings",
    ),
)

_RUN = tuple(p for p in EXPERIMENT if p.name != "protocol")

TUNING = (
    Parameter(
        "delay", "s", 0.05,
        "Time from a reading to the voltage that answers it, beyond half a command period.",
        "simulator: one period of the default command_rate", 0.0, 10.0,
    ),
    Parameter(
        "closed_loop_time", "s", 0.0,
        "Time constant of the closed loop; 0 for half the wire's, or the delay if longer.",
        "SIMC rule", 0.0, 100.0,
    ),
    Parameter(
        "maximum_power", "W", 0.0,
        "Highest power of one wire; 0 for what bench.maximum_voltage and _current allow.",
        "choice", 0.0, 1000.0,
    ),
    Parameter(
        "power_rate", "W/s", 0.0, "Fastest change of a wire's power; 0 for no limit.",
        "choice", 0.0, 1e6,
    ),
)

TEMPERATURE_CONTROLLER = (
    Parameter(
        "reference", "", "temperature_staircase",
        "Wire temperatures to follow: a name in config/references or the path of a .yaml file; "
        "empty for the topic ~/reference (degC, one a channel).",
        "experiment E8", kind="string",
    ),
    *_RUN,
    *TUNING,
)

DEFLECTION_CONTROLLER = (
    Parameter(
        "reference", "", "deflection_triangle",
        "Deflection to follow: a name in config/references or the path of a .yaml file; empty "
        "for the topic ~/reference (m).",
        "experiment E12", kind="string",
    ),
    *_RUN,
    *TUNING,
)

NODE_TABLES: dict[str, tuple[Parameter, ...]] = {
    "simulator": SIMULATOR,
    "serial_bridge": SERIAL_BRIDGE,
    "ir_camera": IR_CAMERA,
    "synthetic_camera": SYNTHETIC_CAMERA,
    "experiment": EXPERIMENT,
    "recorder": RECORDER,
    "identification": IDENTIFICATION,
    "diagnosis": DIAGNOSIS,
    "investigation": INVESTIGATION,
    "twin": TWIN,
    "temperature_controller": TEMPERATURE_CONTROLLER,
    "deflection_controller": DEFLECTION_CONTROLLER,
}


def node_groups() -> set[str]:
    """Groups that only nodes declare: the same file may hold them beside the contract's."""
    contract = {name.split(".")[0] for name in BY_NAME} | {UNCERTAINTY_PREFIX.rstrip(".")}
    nodes = {p.name.split(".")[0] for table in NODE_TABLES.values() for p in table}
    return nodes - contract

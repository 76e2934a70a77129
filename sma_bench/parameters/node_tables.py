"""Each node's own parameters, beside the contract's (table.py)."""

from sma_bench.parameters.bridge_table import SERIAL_BRIDGE
from sma_bench.parameters.camera_tables import IR_CAMERA, SYNTHETIC_CAMERA
from sma_bench.parameters.parameter import MANAGED, Parameter, fixed
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.twin_table import TWIN

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

EMULATED_BENCH = (
    Parameter(
        "port", "", "",
        "Path of a link to make to the emulated port, for a bridge to open; empty for none.",
        "choice", kind="string", read_only=True,
    ),
    *(
        p for p in SIMULATOR
        if p.name in ("seed", "rate.temperature")
        or p.name.startswith("sensor.temperature")
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
    MANAGED,
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
    "emulated_bench": EMULATED_BENCH,
    "ir_camera": IR_CAMERA,
    "synthetic_camera": SYNTHETIC_CAMERA,
    "experiment": EXPERIMENT,
    "recorder": RECORDER,
    "identification": IDENTIFICATION,
    "diagnosis": DIAGNOSIS,
    "twin": TWIN,
    "temperature_controller": TEMPERATURE_CONTROLLER,
    "deflection_controller": DEFLECTION_CONTROLLER,
}


def node_groups() -> set[str]:
    """Groups that only nodes declare: the same file may hold them beside the contract's."""
    contract = {name.split(".")[0] for name in BY_NAME} | {UNCERTAINTY_PREFIX.rstrip(".")}
    nodes = {p.name.split(".")[0] for table in NODE_TABLES.values() for p in table}
    return nodes - contract

"""Parameters of the twin node."""

from sma_bench.parameters.parameter import Parameter

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
        "choice: 25 bins, enough to tell a noise", 2.0, 60.0,
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

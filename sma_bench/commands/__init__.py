"""The commands of sma-bench; ./bench reads this table without importing the package."""

COMMANDS = {
    "example": "copy the files of a documentation page, or a rig's parameters, to a new folder",
    "try": "a first look: from logger tables, instrument files or bags to one page of results",
    "info": "show the contents of a record, and findings about its quality",
    "import": "convert tables of other loggers (CSV, Excel, MATLAB, ...) or bags of other benches",
    "identify": "identify the parameters of Table I from bags and instrument files",
    "diagnose": "locate the gap between simulation and bench, its cause, and how far it shrinks",
    "investigate": "repeat experiment and diagnosis until the cause of the gap is found",
    "batch": "identify or diagnose many records, each on its own, on all cores or a cluster",
    "compare": "overlay records and models with aligned clocks, and list their differences",
    "report": "write records and results as one page, with figures, tables and provenance",
    "audit": "check a lab's parameters against each other and against physics",
    "parameters": "list every parameter with unit, value and source",
    "effects": "list effects that the paper's model leaves out: stage, size, signs in the data",
    "linearise": "linearise the model at an operating point (E11), as printed and corrected",
    "simulate": "simulate the paper's model with a protocol or with the voltages of a bag",
    "paper": "redraw the paper's figures, tables and errata from data",
    "calibrate": "fit gain and offset of a sensor of the Uno from known loads",
    "dashboard": "show a bench live in the browser, with a stop button",
    "call": "call a service of a running node: sma-bench call experiment/start",
    "run": "run a node: sma-bench run NODE [--ros-args ...]",
    "demo": "simulated benches, bags, identification and diagnosis in one go",
}
# The module that defines `run_NAME` of each command.
MODULES = {name: module for module, names in {
    "answers": ("identify", "diagnose", "try", "batch", "investigate"),
    "records": ("info", "import"), "pages": ("report", "compare", "paper"),
    "parameters": ("parameters", "effects", "audit", "example"),
    "models": ("simulate", "linearise"), "nodes": ("run", "call", "dashboard"),
    "calibrate": ("calibrate",), "demo": ("demo",),
}.items() for name in names}

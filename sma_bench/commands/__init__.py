"""The commands of sma-bench; ./bench reads their table without importing it."""

COMMANDS = {
    "example": "the files of a documentation page, or a rig's parameters, in a new folder",
    "try": "from a logger's table, an instrument's file or a bag to one page",
    "info": "what a record holds and whether it can be trusted",
    "import": "tables of other loggers (CSV, Excel, MATLAB, HDF5, Parquet) to bags",
    "identify": "parameters of Table I from bags and instrument files",
    "diagnose": "where simulation and bench disagree, which effect causes it, how far it shrinks",
    "investigate": "record, diagnose, propose, run, until the cause of the gap is named",
    "batch": "many records, each identified or diagnosed by itself, on all cores or a cluster",
    "compare": "records and models over each other, clocks aligned, worst difference in numbers",
    "report": "records and results as one page, with figures, tables and provenance",
    "audit": "do a lab's own numbers fit each other, and physics?",
    "parameters": "every parameter with unit, default, range and source",
    "effects": "what the paper's model leaves out: stage, size, how it shows",
    "linearise": "the linearised model (E11) about any operating point, printed and corrected",
    "simulate": "the paper's model on a protocol or on the voltages of a bag",
    "paper": "the paper's figures, tables and errata redrawn from data",
    "calibrate": "gain and offset of a sensor of the Uno from known loads",
    "dashboard": "a bench live in the browser, with a stop that works",
    "call": "call a service of a running node: sma-bench call experiment/start",
    "run": "run a node: sma-bench run NODE [--ros-args ...]",
    "demo": "simulated benches, bags, identification, diagnosis, in one go",
}
# Of each command the module that it stands in, as `run_NAME`.
MODULES = {name: module for module, names in {
    "answers": ("identify", "diagnose", "try", "batch", "investigate"),
    "records": ("info", "import"), "pages": ("report", "compare", "paper"),
    "parameters": ("parameters", "effects", "audit", "example"),
    "models": ("simulate", "linearise"), "nodes": ("run", "call", "dashboard"),
    "calibrate": ("calibrate",), "demo": ("demo",),
}.items() for name in names}

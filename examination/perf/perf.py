"""Speed of the package, compared with alternatives: `./bench perf [SECTION ...]`."""

import json
import sys
import time
from importlib import import_module
from pathlib import Path

from examination.pieces import options_of, print_table

# Function that yields the figures of each section, by module, and a description.
SECTIONS = {
    "simulation": ("solvers", "stiff solvers at equal error"),
    "reading": ("work", "bags: rosbags, mcap-ros2-support"),
    "commands": ("work", "help, identification, diagnosis; a diagnosis with nothing compiled"),
    "diagnosis": ("work", "development cases; records of 10 minutes to 8 hours"),
    "identification": ("work", "E10 over minutes to an hour, memory"),
    "nodes": ("nodes", "the simulator's rates and latency against a bare pair of rclpy")}


def main(argv: list[str]) -> int:
    """Measure the sections, print a table of each, write the values to `--json FILE`."""
    lines = "\n".join(f"  {name:14} {text}" for name, (_, text) in SECTIONS.items())
    options = options_of("perf", f"{__doc__}\n\n{lines}", argv,
                         sections=(list(SECTIONS), "these only"),
                         json=(Path, "write the figures to this file"),
                         tiny=(False, "on tiny sizes: does it run?"))
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in options.sections or SECTIONS:
        begin, figures, missing = time.monotonic(), [], ""
        try:
            module = import_module(f"examination.perf.{SECTIONS[name][0]}")
            figures.extend(getattr(module, name)(options.tiny))
        except (ImportError, RuntimeError, OSError) as error:  # continue with the others
            missing = f"not measured: {type(error).__name__}: {error}\n"
        rows = [(f.case, f.measure, f"{f.value:.3g}", f.unit, f.aim, f.verdict) for f in figures]
        print(f"{name} ({time.monotonic() - begin:.0f} s)")
        print_table(("case", "measure", ">value", "unit", "aim", ""), rows)
        print(missing)
        cases = found[name] = {}
        for figure in figures:
            cases.setdefault(figure.case, {})[figure.measure] = float(figure.value)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

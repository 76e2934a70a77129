"""Speed of the package, compared with alternatives: `./bench perf [SECTION ...]`."""

import argparse
import json
import sys
import time
from importlib import import_module
from pathlib import Path

from examination.pieces import print_table

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
    parser = argparse.ArgumentParser(prog="bench perf", description=f"{__doc__}\n\n{lines}")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="these only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")
    parser.add_argument("--tiny", action="store_true", help="on tiny sizes: does it run?")
    arguments = parser.parse_args(argv)
    if unknown := [name for name in arguments.sections if name not in SECTIONS]:
        parser.error(f"no section {unknown[0]}, expected one of {', '.join(SECTIONS)}")
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in arguments.sections or SECTIONS:
        begin, figures, missing = time.monotonic(), [], ""
        try:
            module = import_module(f"examination.perf.{SECTIONS[name][0]}")
            figures.extend(getattr(module, name)(arguments.tiny))
        except (ImportError, RuntimeError, OSError) as error:  # continue with the others
            missing = f"not measured: {type(error).__name__}: {error}\n"
        rows = [(f.case, f.measure, f"{f.value:.3g}", f.unit, f.aim, f.verdict) for f in figures]
        print(f"{name} ({time.monotonic() - begin:.0f} s)")
        print_table(("case", "measure", ">value", "unit", "aim", ""), rows)
        print(missing)
        cases = found[name] = {}
        for figure in figures:
            cases.setdefault(figure.case, {})[figure.measure] = float(figure.value)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

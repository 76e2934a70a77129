"""How fast the package is, beside what one would pick instead: `./bench perf [SECTION ...]`."""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

# The fits' matrices are small: BLAS threads that wait for each other only slow them down.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from examination.perf.figures import Outcome, Skipped, as_json, print_section  # noqa: E402

SECTIONS = {
    "simulation": ("simulation", "stiff solvers at equal error"),
    "solver": ("solvers", "the estimation's own solver beside scipy's least_squares"),
    "reading": ("reading", "bags: rosbags, mcap-ros2-support, the bytes alone"),
    "commands": ("whole_commands", "help, identification, diagnosis; cold and warm"),
    "diagnosis": ("diagnosing", "by stage, its derivatives, records of minutes to hours"),
    "identification": ("identifying", "E10 over minutes to hours, memory; the coverage check"),
    "nodes": ("node_rates", "rates, jitter, latency, share of a core; the camera"),
    "twin": ("twin_pace", "whether the twin keeps 500 Hz, and what it takes of a core"),
    "growth": ("growth", "with length, wires, effects, parameter sets"),
    "batch": ("batches", "identified, diagnosed; processes, a dask cluster; a thousand"),
}


def main(argv: list[str]) -> int:
    """Measure the sections, print a table of each, write `--json FILE`."""
    lines = "\n".join(f"  {name:14} {text}" for name, (_, text) in SECTIONS.items())
    parser = argparse.ArgumentParser(
        prog="bench perf", description=f"{__doc__}\n\nsections:\n{lines}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="these only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")
    parser.add_argument(
        "--tiny", action="store_true", help="every section on tiny sizes: does it run?"
    )
    arguments = parser.parse_args(argv)
    unknown = [name for name in arguments.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {unknown[0]}, expected one of {', '.join(SECTIONS)}")
    found: dict[str, list[Outcome]] = {}
    for name in arguments.sections or SECTIONS:
        module = import_module(f"examination.perf.{SECTIONS[name][0]}")
        measure: Callable[[bool], list[Outcome]] = module.measure
        begin = time.monotonic()
        try:
            found[name] = measure(arguments.tiny)
        except (RuntimeError, OSError) as error:  # a rival that fails must not end the others
            found[name] = [Skipped(name, f"{type(error).__name__}: {error}")]
        print_section(name, found[name], time.monotonic() - begin)
    if arguments.json:
        arguments.json.write_text(json.dumps(as_json(found), indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""How fast the package is, beside what one would pick instead: `./bench perf [SECTION ...]`."""

import argparse
import json
import math
import sys
import time
from importlib import import_module
from pathlib import Path

import yaml

from examination.perf.measuring import Figure
from examination.pieces import print_table

SECTIONS: dict[str, str] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
MODULES = {"simulation": "solvers", **dict.fromkeys(("nodes", "bench", "twin"), "nodes")}


def main(argv: list[str]) -> int:
    """Measure the sections, print a table of each, write `--json FILE`."""
    lines = "\n".join(f"  {name:14} {text}" for name, text in SECTIONS.items())
    parser = argparse.ArgumentParser(prog="bench perf", description=f"{__doc__}\n\n{lines}")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="these only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")
    parser.add_argument("--tiny", action="store_true", help="on tiny sizes: does it run?")
    arguments = parser.parse_args(argv)
    unknown = [name for name in arguments.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {unknown[0]}, expected one of {', '.join(SECTIONS)}")
    found = {}
    for name in arguments.sections or SECTIONS:
        begin, figures, missing = time.monotonic(), list[Figure](), ""
        try:
            module = import_module("examination.perf." + MODULES.get(name, "work"))
            for figure in getattr(module, name)(arguments.tiny):
                figures.append(figure)
        except (ImportError, RuntimeError, OSError) as error:  # the others go on
            missing = f"{type(error).__name__}: {error}"
        rows = [(f.case, f.measure, f"{f.value:.3g}", f.unit, f.aim, f.verdict) for f in figures]
        print(f"{name} ({time.monotonic() - begin:.0f} s)")
        print_table(("case", "measure", ">value", "unit", "aim", ""), rows)
        print(f"not measured: {missing}\n" if missing else "")
        kept = [{"case": f.case, "measure": f.measure, "unit": f.unit, "aim": f.aim,
                 "verdict": f.verdict, "value": float(f.value) if math.isfinite(f.value) else None}
                for f in figures]
        found[name] = {"figures": kept, "missing": missing}
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

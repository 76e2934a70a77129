"""How long simulation, readers and camera take, side by side: `./bench perf [--json FILE]`."""

import argparse
import json
import sys
from pathlib import Path

import camera_frames
import read_bags
import run_simulation

PARTS = {
    "simulation": run_simulation.measure,
    "bags": read_bags.measure,
    "camera": camera_frames.measure,
}


def main(argv: list[str]) -> int:
    """Measure all parts, or one; print, and write `--json FILE`."""
    parser = argparse.ArgumentParser(prog="bench perf", description=__doc__)
    parser.add_argument("--only", choices=PARTS, help="this part only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE")
    arguments = parser.parse_args(argv)
    numbers = {}
    for part in [arguments.only] if arguments.only else PARTS:
        print(f"{part}:")
        numbers[part] = PARTS[part]()
    if arguments.json:
        arguments.json.write_text(json.dumps(numbers, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Builds the documentation as a site, strictly: a link or an anchor that leads nowhere fails.

    ./bench check docs [FOLDER]      into build/docs unless given; open index.html there
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = ROOT / "docs" / "site" / "mkdocs.yml"


def main(arguments: Sequence[str]) -> int:
    """0 when the site is built without a warning."""
    folder = Path(arguments[0] if arguments else ROOT / "build" / "docs").resolve()
    code, complaints = build(SETTINGS, folder)
    for line in complaints if code else [str(folder / "index.html")]:
        print(line)
    return code


def build(settings: Path, folder: Path) -> tuple[int, list[str]]:
    """Exit code of the build into `folder`, and what it complained of."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    done = subprocess.run(  # with its --quiet nothing is strict
        [*command, "-f", str(settings), "-d", str(folder)],
        env=dict(os.environ, NO_MKDOCS_2_WARNING="1"),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    return done.returncode, [line for line in done.stdout.splitlines() if line[:4] != "INFO"]

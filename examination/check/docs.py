"""Build the documentation as a site, strictly: a broken link or anchor is an error.

    ./bench check docs [FOLDER]      default build/docs; open index.html there
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = ROOT / "docs" / "site" / "mkdocs.yml"


def main(arguments: Sequence[str]) -> int:
    """0 if the site is built without a warning."""
    folder = Path(arguments[0] if arguments else ROOT / "build" / "docs").resolve()
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(SETTINGS), "-d",
               str(folder)]  # not --quiet, which disables --strict
    done = subprocess.run(command, env=dict(os.environ, NO_MKDOCS_2_WARNING="1"), check=False,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    complaints = [line for line in done.stdout.splitlines() if line[:4] != "INFO"]
    print(*(complaints if done.returncode else [folder / "index.html"]), sep="\n")
    return done.returncode

"""Run the tests without optional packages, and with a stand-in for ROS's `launch`.

`colcon test` runs with the packages of package.xml and requirements-robot.txt, and with `launch`,
whose pytest plugin stops loggers from propagating their records. This makes such an environment of
links to the packages that ./bench has installed. Tests without numba are run by .ci/noble.

    ./bench check bare [pytest options]
"""

import os
import re
import subprocess
import sys
import tempfile
import venv
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Plugins to run tests in parallel and again; and packages that no test may rely on.
RUNNERS = ("pytest-xdist", "pytest-rerunfailures")
SIDE_BY_SIDE = ("-n", "auto", "--maxprocesses", "8", "--dist", "loadfile", "--no-loadscope-reorder")
# The effect of importing launch.logging on Python's logging; launch_testing is a pytest plugin.
LAUNCH = """\
import logging


class LaunchLogger(logging.getLoggerClass()):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.propagate = False


logging.root.setLevel(logging.INFO)
logging.setLoggerClass(LaunchLogger)
"""
INFO = "launch_testing-0.dist-info"
PLUGIN = {"launch/__init__.py": "", "launch/logging.py": LAUNCH,
          f"{INFO}/METADATA": "Metadata-Version: 2.1\nName: launch_testing\nVersion: 0\n",
          f"{INFO}/entry_points.txt": "[pytest11]\nlaunch = launch.logging\n"}  # fmt: skip


def needed(names: Sequence[str]) -> dict[str, metadata.Distribution]:
    """These distributions and all that they require, by name."""
    found: dict[str, metadata.Distribution] = {}
    waiting = list(names)
    while waiting:
        name, _, extra = waiting.pop().partition("[")
        key = re.sub(r"[-_.]+", "-", name).lower()
        if key in found and not extra:
            continue
        try:
            found[key] = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # required on another Python or system only
            continue
        for line in found[key].requires or ():
            wanted = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
            if wanted is None or wanted[1] == extra.rstrip("]"):
                waiting.append(re.match(r"[\w.-]+", line)[0])
    return found


def linked(folder: Path) -> list[str]:
    """Make an environment in `folder`; the names of packages that are left out."""
    venv.create(folder, symlinks=True)
    here = Path(metadata.distribution("sma_bench").locate_file("")).resolve()
    there = next(folder.glob("lib/python*/site-packages"))
    ros = [d.name for d in metadata.distributions() if d.name.startswith("ros-")]
    chosen = needed(["sma_bench[test]", "setuptools", *RUNNERS, *ros])

    def link(path: Path, target: Path) -> None:
        if not path.exists():
            path.symlink_to(target)

    for distribution in chosen.values():
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            link(there / top, here / top)
    # Libraries of ROS's wheels, and their shared files.
    for place in ("lib", "share"):
        (folder / place).mkdir(exist_ok=True)
        for path in (Path(sys.prefix) / place).iterdir():
            link(folder / place / path.name, path)
    for name, text in PLUGIN.items():
        (there / name).parent.mkdir(exist_ok=True)
        (there / name).write_text(text)
    # The other packages installed by ./bench; ROS's wheels contain further distributions.
    lists = [path.read_text() for path in ROOT.glob("requirements-*.txt")]
    pinned = {name for text in lists for name in re.findall(r"^([\w.-]+)==", text, re.MULTILINE)}
    installed = {re.sub(r"[-_.]+", "-", d.name).lower() for d in metadata.distributions()}
    return sorted((installed & pinned) - chosen.keys())


def main(arguments: Sequence[str]) -> int:
    """Exit status of pytest, run in parallel unless -n is given."""
    with tempfile.TemporaryDirectory() as folder:
        without = linked(Path(folder))
        print(f"without {', '.join(without)}; with launch's logging", flush=True)
        python, path = f"{folder}/bin/python", f"{folder}/bin{os.pathsep}{os.defpath}"
        left_out = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
        kept = {name: value for name, value in os.environ.items() if name not in left_out}
        environment = {**kept, "VIRTUAL_ENV": folder, "PATH": path}
        # Compile first, as ./bench does, or the first tests of nodes would wait for it.
        compiling = [python, "-m", "sma_bench.physics"]
        subprocess.run(compiling, cwd=ROOT, env=environment, check=True)
        words = [python, "-m", "pytest", *(() if "-n" in arguments else SIDE_BY_SIDE), *arguments]
        return subprocess.run(words, cwd=ROOT, env=environment, check=False).returncode

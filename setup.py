"""Builds sma_bench for `colcon build` and `pip install .`; package.xml names and versions it."""

import os
import subprocess
from functools import partialmethod
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

MANIFEST = ElementTree.parse(Path(__file__).resolve().parent / "package.xml").getroot()
PACKAGE = MANIFEST.findtext("name")
MAINTAINER = MANIFEST.find("maintainer")
NODES = [
    "simulator",
    "serial_bridge",
    "ir_camera",
    "synthetic_camera",
    "experiment",
    "recorder",
    "identification",
    "diagnosis",
    "investigation",
    "twin",
    "temperature_controller",
    "deflection_controller",
    "bench",  # several of them in one process
]

# Imported packages, except ROS, which pip cannot install. The oldest versions are those of Ubuntu
# 24.04 (requirements-noble.txt).
REQUIRED = [
    'backports-zstd; python_version < "3.14"',
    "click>=8.1",
    "h5py>=3.10",
    "jinja2>=3.1",
    "joblib>=1.3",
    "lz4",
    "matplotlib>=3.6",
    "mcap",
    "msgspec",
    "numba",
    "numpy>=1.26",
    "openpyxl>=3.1",
    "pint>=0.23",
    "pyserial>=3.5",
    "pyyaml>=6",
    "rich>=13.7",
    "rosbags>=0.11.9",
    "scipy>=1.11",
    "tornado",
]

# Endings of the package's data files.
KINDS = ("html", "css", "svg", "js", "j2", "yaml")

# Executable written by `setup.py install` and `develop`, which colcon runs. The one of setuptools
# first searches the metadata of all installed packages, where Ctrl-C prints a traceback.
SCRIPT = f"""\
import os
import signal

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: os._exit(0))
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])  # handle one that came before
if __name__ == "__main__":
    if %(name)r == "sma-bench":
        from {PACKAGE}.cli import script

        script()
    from {PACKAGE}.nodes import start

    getattr(start, %(name)r)()
"""


# Ctrl-C is blocked while Python starts, because it would print a traceback before our code runs.
WAITING = ["/usr/bin/env", "-S", "--block-signal=INT"]


def use_own_script():
    """Make setuptools write SCRIPT; another version may not have this class, and writes its own."""
    for module in ("setuptools._scripts", "setuptools.command.easy_install"):
        try:
            writer = import_module(module).ScriptWriter
        except (ImportError, AttributeError):
            continue
        if writer.template != SCRIPT:
            writer.template = SCRIPT
            if can_wait():
                spec = writer.command_spec_class
                spec.as_header = partialmethod(waiting_header, spec.as_header)


def waiting_header(spec, header):
    """The first line of setuptools, run by `env` with SIGINT blocked."""
    return f"#!{' '.join(WAITING)} {header(spec).removeprefix('#!')}"


def can_wait():
    """True if `env` is from GNU coreutils 8.31 or newer."""
    said = subprocess.run([WAITING[0], WAITING[2], "true"], check=False, capture_output=True)
    return said.returncode == 0


def shared_files(*folders):
    """Data files, installed in the same folders below share/<package>."""
    for folder in folders:
        for directory, _, names in os.walk(folder):
            files = [os.path.join(directory, name) for name in sorted(names) if name[0] != "."]
            if files and "__pycache__" not in directory:
                yield os.path.join("share", PACKAGE, directory), files


use_own_script()
setup(
    name=PACKAGE,
    version=MANIFEST.findtext("version"),
    description=" ".join(MANIFEST.findtext("description").split()),
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get("email"),
    license=MANIFEST.findtext("license"),
    python_requires=">=3.11",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", *(f"**/*.{kind}" for kind in KINDS)]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files("config", "examples", "launch", "firmware"),
    ],
    install_requires=REQUIRED,
    # `test` makes `colcon test` run pytest; all of these are optional.
    extras_require={
        "cluster": ["distributed"],
        "notebook": ["pandas"],
        "parquet": ["pyarrow"],
        "test": ["pytest", "hypothesis"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"sma-bench = {PACKAGE}.cli:main",
            *(f"{node} = {PACKAGE}.nodes.start:{node}" for node in NODES),
        ]
    },
)

"""Builds sma_bench for `colcon build` and `pip install .`; package.xml names and versions it."""

import os
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
    "emulated_bench",
    "ir_camera",
    "synthetic_camera",
    "experiment",
    "recorder",
    "identification",
    "diagnosis",
    "twin",
    "temperature_controller",
    "deflection_controller",
]


# Of `setup.py install` and `develop`, which colcon runs: setuptools' own searches the metadata of
# everything installed first, and a Ctrl-C during that is a traceback.
SCRIPT = f"""\
import os
import signal

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: os._exit(0))
if __name__ == "__main__":
    from {PACKAGE}.nodes.start import script

    script(%(name)r)
"""


def use_own_script():
    """Another setuptools may have it elsewhere: its own then serves, a little later."""
    for module in ("setuptools._scripts", "setuptools.command.easy_install"):
        try:
            import_module(module).ScriptWriter.template = SCRIPT
        except (ImportError, AttributeError):
            continue


def shared_files(*folders):
    """Data files that keep their folders below share/<package>."""
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
    package_data={PACKAGE: ["py.typed", "**/*.html", "**/*.css", "**/*.js", "**/*.j2", "**/*.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files("config", "launch", "firmware"),
    ],
    install_requires=["setuptools"],
    # `test` is what makes `colcon test` run pytest; the package works without the others.
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

"""package.xml, setup.py and the requirements say the same, and all that the code imports; every
version has its hashes written down."""

import ast
import re
import sys
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import yaml

import sma_bench
from examination.check import pins as check_pins

ROOT = Path(__file__).resolve().parents[2]

INDEX = yaml.safe_load(Path(__file__).with_name("rosdep.yaml").read_text())
# Module: distribution, and key of rosdep.
THIRD_PARTY = INDEX["third_party"] | {name: (name, f"python3-{name}") for name in (
    "click", "h5py", "jinja2", "joblib", "matplotlib", "numba", "numpy", "openpyxl", "rich",
    "scipy", "tornado")}  # fmt: skip
ROS = re.compile(r"rclpy|rosidl_\w+|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)")
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()


def imported():
    """Top-level modules that the package and its launch files import, less Python's own."""
    found = set()
    for path in [*ROOT.glob("sma_bench/**/*.py"), *ROOT.glob("launch/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found - sys.stdlib_module_names - {"sma_bench", "compression"}


def pins(name):
    return set(re.findall(r"^([\w.-]+)==", (ROOT / name).read_text(), re.MULTILINE))


def test_version_is_the_same_everywhere():
    assert MANIFEST.findtext("version") == sma_bench.__version__
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == sma_bench.__version__ and cited["license"] == "Apache-2.0"


def test_every_import_is_pinned_and_declared():
    declared = {element.text for element in MANIFEST if element.tag.endswith("depend")}
    modules = imported()
    ours = {module for module in modules if not ROS.fullmatch(module)}
    assert modules - ours <= declared
    optional = {"distributed": "cluster", "pandas": "notebook", "pyarrow": "parquet"}
    assert ours - set(THIRD_PARTY) == set(optional)  # the package does without
    assert set(optional) <= pins("requirements-test.txt")
    assert {*optional.values()} <= {*metadata.metadata("sma_bench").get_all("Provides-Extra")}
    packages, keys = zip(*(THIRD_PARTY[module] for module in ours - set(optional)), strict=True)
    assert {*packages} <= pins("requirements.txt") and {*keys} - {None} <= declared
    # `rosdep install` ends at a name that it does not know.
    assert declared == {*INDEX["keys"], *INDEX["jazzy"].split()}
    # pip installs what is imported and nothing else.
    lines = [line for line in metadata.requires("sma_bench") if "extra ==" not in line]
    required = [re.match(r"[\w.-]+", line)[0].lower() for line in lines]
    assert sorted(required) == sorted(packages)


def test_every_lock_is_whole_and_agrees_with_the_others():
    assert check_pins.problems() == [], "run: ./bench check pins --write"

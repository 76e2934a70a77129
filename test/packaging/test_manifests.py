"""package.xml, setup.py and the requirements say the same, and all that the code imports; every
version has its hashes written down."""

import ast
import re
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import yaml

import sma_bench
from examination.check import pins as check_pins

ROOT = Path(__file__).resolve().parents[2]

INDEX = yaml.safe_load(Path(__file__).with_name("rosdep.yaml").read_text())
THIRD_PARTY = INDEX["third_party"]
SAME = ("click", "h5py", "jinja2", "joblib", "matplotlib", "numba", "numpy", "openpyxl")
SAME += ("rich", "scipy", "tornado")
THIRD_PARTY |= {name: (name, f"python3-{name}") for name in SAME}
# Of what the package does without: the extra of setup.py that names it.
OPTIONAL = {"distributed": "cluster", "pandas": "notebook", "pyarrow": "parquet"}
ROS = re.compile(r"rclpy|rosidl_\w+|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)")
STAGED = tuple(f"requirements{part}.txt" for part in ("-build", "", "-test", "-docs", "-perf"))
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()


@cache
def imported() -> frozenset[str]:
    """Top-level modules that the package and its launch files import, less Python's own."""
    found: set[str] = set()
    for path in [*ROOT.glob("sma_bench/**/*.py"), *ROOT.glob("launch/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return frozenset(found - sys.stdlib_module_names - {"sma_bench", "compression"})


def pins(*names: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for name in names:
        found |= re.findall(r"^([\w.-]+)==([\w.]+)", (ROOT / name).read_text(), re.MULTILINE)
    return found


def test_version_is_the_same_everywhere() -> None:
    assert MANIFEST.findtext("version") == sma_bench.__version__
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == sma_bench.__version__ and cited["license"] == "Apache-2.0"


def test_every_import_is_pinned_and_declared() -> None:
    pinned, staged = pins("requirements.txt"), pins(*STAGED)
    declared = {element.text for element in MANIFEST if element.tag.endswith("depend")}
    extras = metadata.metadata("sma_bench").get_all("Provides-Extra") or []
    for module in sorted(imported()):
        if ROS.fullmatch(module):
            assert module in declared, f"{module} is not in package.xml"
        elif module in OPTIONAL:
            assert module in staged, f"{module} is pinned for no test"
            assert OPTIONAL[module] in extras, f"setup.py has no extra {OPTIONAL[module]}"
        else:
            assert module in THIRD_PARTY, f"{module} is imported but not known here"
            package, key = THIRD_PARTY[module]
            assert package in pinned, f"{package} is not in requirements.txt"
            assert key is None or key in declared, f"{key} is not in package.xml"
    # `rosdep install` ends at a name that it does not know.
    assert declared == {*INDEX["keys"], *INDEX["jazzy"].split()}
    # pip installs what is imported and nothing else.
    lines = [line for line in metadata.requires("sma_bench") if "extra ==" not in line]
    required = [re.match(r"[\w.-]+", line)[0].lower() for line in lines]
    assert sorted(required) == sorted(THIRD_PARTY[m][0] for m in imported() & set(THIRD_PARTY))


def test_every_lock_is_whole_and_agrees_with_the_others() -> None:
    assert check_pins.problems() == [], "run: ./bench check pins --write"

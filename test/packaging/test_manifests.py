"""package.xml, setup.py and the requirements say the same, and all that the code imports."""

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import sma_bench

ROOT = Path(__file__).resolve().parents[2]

# Module, its name at the package index, its rosdep key.
THIRD_PARTY = {
    "backports": ("backports-zstd", None),  # comes with rosbags, Python's own from 3.14 on
    "click": ("click", "python3-click"),
    "h5py": ("h5py", "python3-h5py"),
    "jinja2": ("jinja2", "python3-jinja2"),
    "joblib": ("joblib", "python3-joblib"),
    "lz4": ("lz4", None),  # comes with rosbags
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mcap": ("mcap", None),
    "msgspec": ("msgspec", None),
    "numba": ("numba", "python3-numba"),
    "numpy": ("numpy", "python3-numpy"),
    "openpyxl": ("openpyxl", "python3-openpyxl"),
    "pint": ("pint", None),  # a Debian package, but no rosdep key
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "scipy": ("scipy", "python3-scipy"),
    "serial": ("pyserial", "python3-serial"),
    "tornado": ("tornado", "python3-tornado"),
    "yaml": ("pyyaml", "python3-yaml"),
}
# The same of what the package does without, with the extra of setup.py that names it.
OPTIONAL = {"distributed": ("distributed", "cluster"), "pandas": ("pandas", "notebook"),
            "pyarrow": ("pyarrow", "parquet")}
ROS = re.compile(r"rclpy|rosidl_\w+|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)")


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


STAGED = ("requirements-build.txt", "requirements.txt", "requirements-test.txt",
          "requirements-docs.txt", "requirements-perf.txt")  # fmt: skip


def pins(*names: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for name in names:
        found |= re.findall(r"^([\w.-]+)==([\w.]+)", (ROOT / name).read_text(), re.MULTILINE)
    return found


MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()


def test_version_is_the_same_everywhere() -> None:
    assert MANIFEST.findtext("version") == sma_bench.__version__
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == sma_bench.__version__ and cited["license"] == "Apache-2.0"


def test_every_import_is_pinned_and_declared() -> None:
    pinned = pins("requirements.txt")
    declared = {element.text for element in MANIFEST if element.tag.endswith("depend")}
    for module in sorted(imported()):
        if ROS.fullmatch(module):
            assert module in declared, f"{module} is not in package.xml"
            continue
        if module in OPTIONAL:
            continue
        assert module in THIRD_PARTY, f"{module} is imported but not known here"
        package, key = THIRD_PARTY[module]
        assert package in pinned, f"{package} is not in requirements.txt"
        assert key is None or key in declared, f"{key} is not in package.xml"
    # `rosdep install` ends at a name that it does not know.
    keys = {key for _, key in THIRD_PARTY.values()} | {"python3-hypothesis", "python3-pytest"}
    assert {name for name in declared if name.startswith("python3-")} <= keys


def test_pip_installs_what_is_imported_and_nothing_else() -> None:
    requirements = [
        re.match(r"[\w.-]+", line)[0].lower()
        for line in metadata.requires("sma_bench")
        if "extra ==" not in line
    ]
    expected = [THIRD_PARTY[module][0] for module in imported() & set(THIRD_PARTY)]
    assert sorted(requirements) == sorted(expected)


def test_optional_imports_are_pinned_for_the_tests_and_extras_of_the_package() -> None:
    extras = metadata.metadata("sma_bench").get_all("Provides-Extra") or []
    for module in sorted(imported() & set(OPTIONAL)):
        package, extra = OPTIONAL[module]
        assert package in pins(*STAGED)
        assert extra in extras, f"setup.py has no extra {extra}"


def test_pins_are_exact() -> None:
    for path in ROOT.glob("requirements*.txt"):
        for line in path.read_text().splitlines():
            requirement = line.partition("#")[0].strip()
            exact = r'[\w.-]+==[\w.]+(; python_version < "3\.\d+")?'
            assert not requirement or re.fullmatch(exact, requirement), f"{path.name}: {line}"


# In Python's own library from 3.14 on, or from 3.12 on.
OF_SOME_PYTHONS = {"backports-zstd", "importlib-metadata", "lazy-importer", "zipp"}


def test_pinned_packages_fit_together_and_are_complete() -> None:
    if not Path(sys.prefix).is_relative_to(ROOT):
        pytest.skip("not in the environment of ./bench")
    wanted = pins(*STAGED)
    there = {
        re.sub(r"[-_.]+", "-", name).lower(): distribution.version
        for distribution in metadata.distributions(path=[str(p) for p in site_packages()])
        if (name := distribution.metadata["Name"])
    }
    differing = {name: there.get(name) for name in wanted if there.get(name) != wanted[name]}
    assert set(differing) <= OF_SOME_PYTHONS
    check = [sys.executable, "-m", "pip", "check"]
    process = subprocess.run(check, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout


def site_packages() -> list[Path]:
    return list(Path(sys.prefix).glob("lib/python*/site-packages"))

"""Architecture: which packages may import which (rooms.yaml); and ruff finds nothing."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, EXAMINATION = "sma_bench", "examination"
# The examination's own physics: its errors must be independent of the package's.
INDEPENDENT = ("examination.blind.reality", "examination.attack_lab")
BORROWED = {"compiled", "errors", "parameters", "records"}
LONGEST_FILE = 600

HOUSE = yaml.safe_load((ROOT / "test" / "rooms.yaml").read_text())
LEAVES = HOUSE["leaves"].split()
ARROWS = {room: {*below.split(), *LEAVES} for room, below in HOUSE["rooms"].items()}
ARROWS |= {room: {*below.split()} for room, below in HOUSE["alone"].items()}
USES_ROS = {"nodes", "ros"}
ROS = {"rclpy", "launch", "launch_ros", "ament_index_python", "rosidl_runtime_py"}
ROS_ENDINGS = ("_msgs", "_srvs", "_interfaces")


def modules(top=PACKAGE):
    """Path of every module of a package, by its dotted name."""
    paths = {path.relative_to(ROOT): path for path in sorted((ROOT / top).rglob("*.py"))}
    return {".".join(name.with_suffix("").parts).removesuffix(".__init__"): path
            for name, path in paths.items()}  # fmt: skip


def imports(name, path, known):
    """Dotted names that a module imports anywhere: absolute, relative, or as a literal in
    `import_module`."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            full = [".".join([*base, alias.name]) for alias in node.names]
            yield from (one if one in known else ".".join(base) for one in full)
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called == "import_module" and isinstance(node.args[0], ast.Constant):
                yield node.args[0].value


def top(name):
    return name.partition(".")[0]


def room(name):
    """`physics` of `sma_bench.physics.heat`; the package itself is the room ''."""
    return top(name.partition(".")[2])


def test_rooms_import_only_along_the_arrows_and_these_run_one_way():
    known, graph, broken = modules(), {}, []
    for name, path in known.items():
        here, length = room(name), len(path.read_text().splitlines())
        if here not in ARROWS:
            broken.append(f"{name}: the room {here} is not in the table of arrows")
        if length > LONGEST_FILE:
            broken.append(f"{name} has {length} lines, more than {LONGEST_FILE}")
        if path.stem in ("utils", "util", "helpers", "common", "misc"):
            broken.append(f"{name}: a file is named after what it holds")
        targets = set(imports(name, path, known))
        graph[name] = {target for target in targets if top(target) == PACKAGE}
        for target in targets:
            if (top(target) in ROS or top(target).endswith(ROS_ENDINGS)) and here not in USES_ROS:
                broken.append(f"{name} imports {target}: only {' and '.join(USES_ROS)} know ROS")
            if top(target) == EXAMINATION:
                broken.append(f"{name} imports {target}: the package does not know its judge")
        for there in {room(target) for target in graph[name]} - {here} - ARROWS.get(here, set()):
            broken.append(f"{name}: no arrow from {here} to {there}")
    assert broken == []
    for arrows in (graph, ARROWS):
        TopologicalSorter(arrows).prepare()  # raises CycleError
    assert len((ROOT / "bench").read_text().splitlines()) <= LONGEST_FILE


def test_the_reality_of_the_examination_shares_little_with_the_package():
    known = modules() | modules(EXAMINATION)
    borrowed = {(name, target) for name, path in known.items() if name.startswith(INDEPENDENT)
                for target in imports(name, path, known) if top(target) == PACKAGE}  # fmt: skip
    assert {pair for pair in borrowed if room(pair[1]) not in BORROWED} == set()


def test_ruff_finds_nothing():
    """mypy is run in .ci/run."""
    pytest.importorskip("ruff")
    command = [sys.executable, "-m", "ruff", "check", "."]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout + process.stderr


def test_tests_that_are_listed_to_run_again_or_first_exist(request):
    own = request.config.pluginmanager.get_plugin(str(ROOT / "test" / "conftest.py"))
    for name, reason in own.RERUN.items():
        path, _, test = name.partition("::")
        assert f"def {test}(" in (ROOT / path).read_text() and len(reason) > 20, name
    assert [name for name in own.LONGEST if not (ROOT / "test" / f"{name}.py").is_file()] == []

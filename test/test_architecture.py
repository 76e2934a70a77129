"""The rooms of the house: who may import whom, and that ruff and mypy agree with the code."""

import ast
import importlib.util
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, EXAMINATION = "sma_bench", "examination"
# The judge's own physics, which must be wrong in other ways than that of the package.
INDEPENDENT = {
    f"{EXAMINATION}.{room}": {"compiled", "errors", "parameters", "records"}
    for room in ("blind.reality", "attack_lab")
}
LONGEST_FILE = 600

# Every room (folder or file of the package) and the rooms that it may import.
LEAVES = {
    "errors", "border", "findings", "compiled", "progress", "lifeline", "drawn", "installation",
}
ARROWS = {
    "errors": set(),
    "border": {"errors"},
    "findings": set(),
    "drawn": set(),  # is given its room from above: what does not plot does not depend on it
    "compiled": set(),
    "progress": set(),
    "lifeline": set(),
    "installation": {"errors"},
    "parameters": LEAVES,
    "protocols": LEAVES | {"parameters"},
    "physics": LEAVES | {"parameters"},
    "records": LEAVES | {"parameters"},
    "estimation": LEAVES | {"records", "physics", "parameters"},
    "identify": LEAVES | {"estimation", "records", "physics", "parameters", "results", "cards"},
    "control": LEAVES | {"parameters", "physics"},
    "hardware": LEAVES | {"parameters"},
    "synthetic": LEAVES
    | {"records", "physics", "parameters", "protocols", "control", "hardware"},
    "diagnose": LEAVES
    | {"estimation", "records", "physics", "parameters", "protocols", "results", "cards"},
    # The running twin learns noise as the diagnosis does, and steps the simulator's own core.
    "twin": LEAVES | {"estimation", "physics", "parameters"},
    "results": LEAVES | {"parameters"},
    "cards": LEAVES | {"parameters", "results"},
    "report": LEAVES
    | {
        "diagnose", "estimation", "identify", "records", "physics", "parameters", "protocols",
        "results", "cards",
    },
    "tasks": LEAVES
    | {
        "diagnose", "estimation", "identify", "records", "parameters", "protocols", "report",
        "results", "cards",
    },
    # What a running bench does, without ROS.
    "live": LEAVES | {"parameters", "physics", "protocols", "records", "control", "hardware"},
    "dashboard": LEAVES | {"results", "cards"},
    "api": LEAVES
    | {
        "diagnose", "estimation", "identify", "synthetic", "physics", "protocols", "records",
        "parameters",
    },
    "": {"api", "drawn", "installation"},  # `import sma_bench` itself
    # Its context, who may reach it, a bench's client: what nodes and commands share.
    "ros": LEAVES | {"parameters", "records", "live", "dashboard"},
}
_BELOW = {room for room in ARROWS if room not in ("", "api")}
# Nodes and commands use everything but each other, and nothing below uses them.
ARROWS |= {
    "nodes": _BELOW - {"report", "diagnose", "identify", "estimation", "synthetic"},
    "commands": _BELOW | {"api"},
    "cli": {"commands", *LEAVES},
}
USES_ROS = {"nodes", "ros"}
ROS = {"rclpy", "launch", "launch_ros", "ament_index_python", "rosidl_runtime_py"}
ROS_ENDINGS = ("_msgs", "_srvs", "_interfaces")


# --- the checker --------------------------------------------------------------------------------


def modules(root, top=PACKAGE):
    """Dotted name of every module below root/top."""
    found = {}
    for path in sorted((root / top).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name, path, known):
    """Dotted names that a module imports, anywhere in it: absolute, relative, or by a name written
    out in `import_module`."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            for alias in node.names:
                full = ".".join([*base, alias.name])
                yield full if full in known else ".".join(base)
        elif isinstance(node, ast.Call) and _called(node) == "import_module":
            yield from (given.value for given in node.args[:1] if isinstance(given, ast.Constant))


def _called(call):
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def room(name):
    """`physics` of `sma_bench.physics.heat`; the package itself is the room ''."""
    return name.partition(".")[2].partition(".")[0]


def is_ros(name):
    top = name.partition(".")[0]
    return top in ROS or top.endswith(ROS_ENDINGS)


def violations(root, arrows=ARROWS):
    """Everything below root/sma_bench that breaks the rules of the house, a line each."""
    known = modules(root)
    graph = {}
    broken = []
    for name, path in known.items():
        here = room(name)
        if here and here not in arrows:
            broken.append(f"{name}: the room {here} is not in the table of arrows")
            continue
        graph[name] = set()
        for target in imports(name, path, known):
            if is_ros(target) and here not in USES_ROS:
                broken.append(f"{name} imports {target}: only {' and '.join(USES_ROS)} know ROS")
            if target.partition(".")[0] == EXAMINATION:
                broken.append(f"{name} imports {target}: the package does not know its judge")
            if target.partition(".")[0] != PACKAGE:
                continue
            graph[name].add(target)
            there = room(target)
            if there not in {here, *arrows.get(here, set())}:
                broken.append(f"{name} imports {target}: no arrow from {here} to {there}")
        broken += _shape(name, path)
    return broken + _circles(graph)


def borrowed(root):
    """What the judge's own physics takes from the package beyond its leave, a line each."""
    known = modules(root) | modules(root, EXAMINATION)
    return [
        f"{name} imports {target}: {part} borrows nothing from {room(target)}"
        for part, allowed in INDEPENDENT.items()
        for name, path in known.items() if name.startswith(part)
        for target in imports(name, path, known)
        if target.partition(".")[0] == PACKAGE and room(target) not in allowed
    ]


def _shape(name, path):
    length = len(path.read_text().splitlines())
    if length > LONGEST_FILE:
        yield f"{name} has {length} lines, more than {LONGEST_FILE}"
    if path.stem in ("utils", "util", "helpers", "common", "misc"):
        yield f"{name}: a file is named after what it holds"


def _circles(graph):
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return ["circular import: " + " <- ".join(error.args[1])]
    return []


# --- the house ----------------------------------------------------------------------------------


def test_rooms_import_only_along_the_arrows():
    assert violations(ROOT) == []


def test_the_arrows_themselves_run_one_way():
    assert _circles(ARROWS) == []


def test_the_judges_physics_are_its_own():
    assert borrowed(ROOT) == []


def test_bench_fits_in_the_head():
    assert len((ROOT / "bench").read_text().splitlines()) <= LONGEST_FILE


# --- the checker can fail -----------------------------------------------------------------------


BAD_TREES = {
    "against the arrow": (
        {"physics/heat.py": "from ..identify import fit"},
        "no arrow from physics to identify",
    ),
    "against the arrow, inside a function": (
        {"records/read.py": "def f():\n    import sma_bench.cli"},
        "no arrow from records to cli",
    ),
    "a command that knows a node by its name": (
        {"commands/run.py": "import importlib\nimportlib.import_module('sma_bench.nodes.start')"},
        "no arrow from commands to nodes",
    ),
    "room named by its package": (
        {"physics/heat.py": "from .. import nodes", "nodes/__init__.py": ""},
        "no arrow from physics to nodes",
    ),
    "ROS below the nodes": (
        {"hardware/link.py": "def f():\n    from sensor_msgs.msg import Temperature"},
        "know ROS",
    ),
    "the package that knows its judge": (
        {"physics/heat.py": "def f():\n    from examination.blind.reality import World"},
        "does not know its judge",
    ),
    "circle of two modules": (
        {"physics/a.py": "from .b import y", "physics/b.py": "from . import a"},
        "circular import",
    ),
    "room without a line in the table": ({"attic/box.py": ""}, "not in the table"),
    "utils": ({"physics/utils.py": ""}, "named after what it holds"),
    "long file": ({"physics/long.py": "x = 1\n" * 601}, "601 lines"),
}


@pytest.mark.parametrize("case", BAD_TREES)
def test_a_broken_rule_is_found(case, tmp_path):
    files, expected = BAD_TREES[case]
    found = violations(make_tree(tmp_path, files))
    assert len(found) == 1
    assert expected in found[0]


def test_a_borrowed_equation_is_found(tmp_path):
    folder = tmp_path / EXAMINATION / "blind" / "reality"
    folder.mkdir(parents=True)
    (folder / "heat.py").write_text("from sma_bench.errors import E\nimport sma_bench.physics\n")
    (found,) = borrowed(tmp_path)
    assert "borrows nothing from physics" in found


def test_a_tidy_tree_passes(tmp_path):
    files = {
        "__init__.py": "",
        "errors.py": "class InputError(ValueError): ...",
        "physics/__init__.py": "from .heat import warm",
        "physics/heat.py": "import numpy\nfrom ..errors import InputError\nfrom . import phase",
        "physics/phase.py": "from sma_bench.installation import VERSION",
        "installation.py": "",
        "nodes/simulator.py": "import rclpy\nfrom sma_bench.physics import warm",
        "cli.py": "from sma_bench.commands import run",
        "commands/run.py": "from sma_bench.physics import warm",
    }
    assert violations(make_tree(tmp_path, files)) == []


def make_tree(root, files):
    for name, text in files.items():
        path = root / PACKAGE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


# --- the tools ----------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [["ruff", "check", "."], ["mypy"]], ids=["ruff", "mypy"])
def test_tool_finds_nothing(arguments):
    if importlib.util.find_spec(arguments[0]) is None:
        pytest.skip(f"{arguments[0]} is not installed")
    process = subprocess.run(
        [sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if process.returncode:
        pytest.fail(process.stdout + process.stderr, pytrace=False)


def test_tests_that_are_run_again_are_there_and_say_why(request):
    rerun = request.config.pluginmanager.get_plugin(str(ROOT / "test" / "conftest.py")).RERUN
    for name, reason in rerun.items():
        path, _, test = name.partition("::")
        assert f"def {test}(" in (ROOT / path).read_text() and len(reason) > 20, name

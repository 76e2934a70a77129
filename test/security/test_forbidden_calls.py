"""Nothing of the tree runs what it reads: no pickle, no yaml.load, no shell, no eval."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("sma_bench", "launch", "test")
SCRIPTS = ("bench", "setup.py")

# Modules that run what they load, or that start shells.
MODULES = frozenset({
    "pickle", "cPickle", "_pickle", "cloudpickle", "dill", "shelve", "marshal", "joblib",
    "jsonpickle", "commands", "pty.spawn",
})  # fmt: skip
CALLS = frozenset({
    "yaml.load", "yaml.load_all", "yaml.full_load", "yaml.full_load_all", "yaml.unsafe_load",
    "yaml.unsafe_load_all", "yaml.Loader", "yaml.FullLoader", "yaml.UnsafeLoader", "os.system",
    "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput", "tempfile.mktemp",
    "builtins.eval", "builtins.exec", "eval", "exec", "asyncio.create_subprocess_shell",
    "jinja2.Markup", "markupsafe.Markup",
})  # fmt: skip
# Keyword, and the values that it may have.
KEYWORDS = {
    "shell": (False,), "allow_pickle": (False,), "verify": (True,),
    "autoescape": (True, "xhtml_escape"),
}  # fmt: skip


# Documentation's own examples are run by its tests.
EXAMPLES = {
    "test/docs/page_runner.py": {"exec"}, "test/docs/test_notebooks.py": {"exec", "eval"},
}  # fmt: skip


def offences(text: str) -> Iterator[str]:
    """Line and name of everything in a module that is forbidden."""
    names: dict[str, str] = {}
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            names |= {a.asname or a.name: f"{module}.{a.name}" for a in node.names}
            if module.partition(".")[0] in MODULES:
                yield f"line {node.lineno}: {module}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and not _fills_in_text(node):
            for keyword in node.keywords:
                allowed = KEYWORDS.get(keyword.arg or "")
                if allowed and getattr(keyword.value, "value", None) not in allowed:
                    found = f"{keyword.arg}={ast.unparse(keyword.value)}"
                    yield f"line {keyword.value.lineno}: {found}"
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.partition(".")[0] in MODULES:
                    yield f"line {node.lineno}: {alias.name}"
        elif isinstance(node, (ast.Attribute, ast.Name)) and _dotted(node, names) in CALLS:
            yield f"line {node.lineno}: {_dotted(node, names)}"


def _fills_in_text(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Attribute) and call.func.attr == "format"


def _dotted(node: ast.AST, names: dict[str, str]) -> str:
    parts = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return ""
    return ".".join([names.get(node.id, node.id), *reversed(parts)])


def files() -> list[Path]:
    found = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    return [*found, *(ROOT / script for script in SCRIPTS)]


def test_the_tree_runs_nothing_that_it_reads() -> None:
    assert len(files()) > 300
    found = []
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        for offence in offences(path.read_text()):
            if offence.partition(": ")[2] not in EXAMPLES.get(name, ()):
                found.append(f"{name}: {offence}")
    assert found == []


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from pickle import loads",
        "def f():\n    import cloudpickle as c",
        "import yaml\nyaml.load(x, Loader=yaml.SafeLoader)",
        "from yaml import load as read\nread(x)",
        "import yaml\nclass L(yaml.FullLoader): ...",
        "import subprocess as s\ns.run('ls', shell=True)",
        "run('ls', shell=flag)",
        "import os\nos.system('ls')",
        "eval('1')",
        "import numpy\nnumpy.load('x', allow_pickle=True)",
        "import jinja2\njinja2.Environment(autoescape=False)",
        "from tempfile import mktemp\nmktemp()",
    ],
)
def test_an_offence_is_found(text: str) -> None:
    assert list(offences(text))


@pytest.mark.parametrize(
    "text",
    [
        "import yaml\nyaml.safe_load(x)\nclass L(yaml.SafeLoader): ...",
        "import subprocess\nsubprocess.run(['ls'], shell=False)",
        "import jinja2\njinja2.Environment(autoescape=True)",
        "spec.loader.exec_module(module)\nmodel.eval()",
    ],
)
def test_what_is_allowed_passes(text: str) -> None:
    assert list(offences(text)) == []

"""The package installed as users do it, by colcon and by pip, finds its code and its files."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from sma_bench.parameters.node_tables import NODE_TABLES

EXECUTABLES = {"sma-bench", "bench", *NODE_TABLES}
WHERE = """
import sma_bench
from sma_bench.installation import share_directory
print(share_directory())
"""
INDEXED = """
import ament_index_python
print(sma_bench.__file__)
print(ament_index_python.get_package_share_directory("sma_bench"))
"""
LOAD = """
from importlib.metadata import distribution
for script in distribution("sma_bench").entry_points.select(group="console_scripts"):
    print(script.name, callable(script.load()))
"""

pytestmark = pytest.mark.slow


def run(*command, cwd, **variables):
    """Output of a command that must succeed; no byte code of hundreds of files of which few run."""
    variables |= {"PIP_NO_COMPILE": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    words, env = list(map(str, command)), {**os.environ, **variables}
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    process = subprocess.run(words, cwd=cwd, env=env, text=True, check=False, **streams)
    assert process.returncode == 0, process.stdout
    return process.stdout


def files(folder):
    """Files of config/, examples/ and launch/ below a folder."""
    found = [p for part in ("config", "examples", "launch") for p in (folder / part).rglob("*")]
    found = [path.relative_to(folder) for path in found if path.is_file()]
    return {str(path) for path in found if "__pycache__" not in path.parts}


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "symlink"])
def workspace(checkout, request, tmp_path_factory):
    """A colcon workspace with the package built in it."""
    colcon = Path(sys.executable).with_name("colcon")
    if not colcon.exists():
        pytest.skip("colcon is not installed")
    folder = tmp_path_factory.mktemp("workspace")
    # A sourced workspace has this set; the wheels have no setup.bash that would.
    variables = {"AMENT_PREFIX_PATH": sys.prefix, "COLCON_LOG_LEVEL": "error"}
    source = shutil.copytree(checkout, folder / "src" / "sma_bench")
    options = ["--symlink-install"] if request.param else []
    run(colcon, "build", *options, cwd=folder, **variables)

    def sourced(*command):
        """Output of a command in a shell that has sourced the workspace."""
        words = ("bash", "-c", '. install/local_setup.bash && exec "$@"', "bash", *command)
        return run(*words, cwd=folder, **variables)

    prefix = folder / "install" / "sma_bench"
    return SimpleNamespace(colcon=colcon, source=source, prefix=prefix, run=sourced,
                           linked=request.param)  # fmt: skip


def test_ros2_finds_what_colcon_builds_and_colcon_tests_it(workspace):
    folder, share = workspace.prefix / "lib" / "sma_bench", workspace.prefix / "share"
    assert {path.name for path in folder.iterdir() if os.access(path, os.X_OK)} == EXECUTABLES
    lines = workspace.run(sys.executable, "-c", LOAD).splitlines()
    assert set(lines) == {f"{name} True" for name in EXECUTABLES}
    assert "wire.resistance" in workspace.run(folder / "sma-bench", "parameters")
    assert (share / "ament_index" / "resource_index" / "packages" / "sma_bench").is_file()
    assert (share / "sma_bench" / "package.xml").is_file()

    expected, installed = files(workspace.source), share / "sma_bench"
    assert {name.partition("/")[0] for name in expected} >= {"config", "launch"}
    assert files(installed) == expected
    assert {(installed / name).is_symlink() for name in expected} == {workspace.linked}
    found, code, indexed = workspace.run(sys.executable, "-c", WHERE + INDEXED).splitlines()
    home = workspace.source if workspace.linked else workspace.prefix
    assert Path(code).resolve().is_relative_to(home)
    assert found == str(home if workspace.linked else installed)
    assert indexed == str(installed)
    if not workspace.linked:
        chosen = ["--pytest-args", "test/packaging/test_manifests.py", "-k", "version"]
        workspace.run(workspace.colcon, "test", "--return-code-on-test-failure", *chosen)
        said = workspace.run(workspace.colcon, "test-result", "--all")
        assert "1 test, 0 errors, 0 failures, 0 skipped" in said.replace("tests", "test")


def test_pip_installs_command_and_share_folder(checkout, tmp_path):
    source, target = shutil.copytree(checkout, tmp_path / "source"), tmp_path / "target"
    pip, plainly = [sys.executable, "-m", "pip"], ["--quiet", "--no-deps"]
    wheels, python = tmp_path / "wheels", target / "bin" / "python"
    run(*pip, "wheel", *plainly, "--no-build-isolation", "-w", wheels, source, cwd=tmp_path)
    run(sys.executable, "-m", "venv", "--without-pip", target, cwd=tmp_path)
    run(*pip, "--python", python, "install", *plainly, *wheels.iterdir(), cwd=tmp_path)
    # The dependencies are those of this interpreter; only sma_bench itself is new.
    borrowed = next(Path(path) for path in sys.path if path.endswith("site-packages"))
    site_packages = next(target.glob("lib/python*/site-packages"))
    (site_packages / "borrowed.pth").write_text(f"{borrowed}\n")

    assert "wire.resistance" in run(target / "bin" / "sma-bench", "parameters", cwd=tmp_path)
    share = target / "share" / "sma_bench"
    assert run(python, "-c", WHERE, cwd=tmp_path).strip() == str(share)
    assert files(share) == files(source)
    run(target / "bin" / "sma-bench", "example", "ten_tasks", cwd=tmp_path)
    assert (tmp_path / "ten_tasks" / "run.csv").is_file()

"""./bench sets up its environment once, survives interruption, and fails in short words."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from sma_bench.commands import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
COMMANDS_FILE = "sma_bench/commands/__init__.py"
COMMAND_LINE = "import sys\nprint(*sys.argv[1:])\nsys.exit(len(sys.argv) - 1)\n"
CHECK = "def main(arguments):\n    print(*arguments)\n    return len(arguments)\n"
SETUP = 'import setuptools\nsetuptools.setup(name="sma_bench", version="0", packages=["sma_bench"])'
NOT_THERE = f"no-such-package-of-sma-bench==1.0 --hash=sha256:{'0' * 64}\n"


def locked(name: str) -> str:
    """The lines of a package in the real locks."""
    locks = "\n".join(path.read_text() for path in sorted((ROOT / "locks").iterdir()))
    return re.search(rf"^{name}==.*\n(?: +--hash=.*\n)+", locks, re.MULTILINE)[0]


def make_house(folder: Path, requirements: str | None = None) -> Path:
    """A checkout whose setup takes seconds; its commands print their arguments and count them."""
    rest = [f"locks/requirements-{name}.txt" for name in ("test", "docs", "perf", "notebook")]
    texts = dict.fromkeys(rest, locked("cycler"))
    texts |= {"locks/requirements.txt": requirements or locked("mdurl"), "setup.py": SETUP}
    texts |= {"sma_bench/cli.py": COMMAND_LINE, "examination/check/units.py": CHECK}
    texts |= dict.fromkeys(("package.xml", "sma_bench/__init__.py", COMMANDS_FILE), "")
    real = ("bench", "locks/requirements-build.txt", "setup.cfg", "pyproject.toml")
    real += ("examination/check/__main__.py",)
    texts |= {name: (ROOT / name).read_text() for name in real}
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "bench").chmod(0o755)
    return folder


def start(house: Path, *arguments: str, python: str = sys.executable) -> subprocess.Popen:
    # Byte code of what is only looked at would take most of the time.
    variables = {**os.environ, "BENCH_PYTHON": python, "PIP_NO_COMPILE": "1"}
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE) | {"stdin": subprocess.DEVNULL}
    # Its own process group, so that a test can end it with everything that it started.
    own = {"env": variables, "text": True, "start_new_session": True}
    return subprocess.Popen([house / "bench", *arguments], **streams, **own)


def bench(house: Path, *arguments: str, python: str = sys.executable) -> tuple[int, str, str]:
    process = start(house, *arguments, python=python)
    out, err = process.communicate()
    return process.returncode, out, err


def environment(house: Path) -> Path:
    return next(path for path in house.glob(".venv-*") if path.is_dir())


def installed(house: Path) -> str:
    return " ".join(p.name for p in environment(house).glob("lib/*/site-packages/*.dist-info"))


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout whose first setup was killed and then begun again, by two uses at once."""
    house = make_house(tmp_path_factory.mktemp("house with space") / "sma_bench")
    killed = start(house, "killed")
    for line in killed.stderr:
        if "packages of requirements.txt" in line:
            break
    os.killpg(killed.pid, signal.SIGKILL)
    assert killed.communicate()[0] == ""
    first = start(house, "first", "use")
    begun = first.stderr.readline()
    second = start(house, "two")
    (out, rest), (out_2, err_2) = first.communicate(), second.communicate()
    # The interrupted setup is done again, once: the second of the two waits for the first.
    assert (first.returncode, out) == (2, "first use\n"), rest
    assert begun.startswith("bench: setting up .venv-") and "ready in" in rest
    assert (second.returncode, out_2) == (1, "two\n"), err_2
    assert err_2.endswith("waiting for it\n") and err_2.count("\n") == 1
    return house


@pytest.mark.slow
def test_after_an_interrupted_setup_commands_run_at_once_and_what_is_needed_comes_when_it_is(
    house: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("audit", "lab file.yaml", "--json")
    assert bench(house, *words) == (3, "audit lab file.yaml --json\n", "")
    # Its Python has one thread for linear algebra.
    code = "import os; print(os.environ['OMP_NUM_THREADS'])"
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert bench(house, "python", "-c", code) == (0, "1\n", "")
    assert "mdurl" in installed(house) and "cycler" not in installed(house)
    code, out, err = bench(house, "check", "units", "one")
    assert (code, out) == (1, "one\n"), err
    assert "cycler" in installed(house)
    (house / "setup.py").write_text(SETUP.replace('version="0"', 'version="1"'))
    code, _, err = bench(house, "x")
    assert code == 1
    assert "sma_bench itself" in err and "setting up" not in err
    assert "sma_bench-1.dist-info" in installed(house)


@pytest.mark.slow
def test_package_that_does_not_exist_is_told_in_short(house: Path, tmp_path: Path) -> None:
    made = environment(house)
    house = make_house(tmp_path / "house", f"--no-index\n{NOT_THERE}")
    # A copy of an environment, as it takes seconds to make one.
    text, making = (house / "bench").read_text(), '[sys.executable, "-m", "venv", self.path]'
    assert making in text
    (house / "bench").write_text(text.replace(making, f'["cp", "-a", {str(made)!r}, self.path]'))
    code, out, err = bench(house, "x")
    assert (code, out) == (2, "")
    assert "1 packages of requirements.txt: failed" in err
    assert "No matching distribution found for no-such-package-of-sma-bench==1.0" in err
    assert "Traceback" not in err and len(err.splitlines()) < 15
    log = Path(err.rsplit("everything it said: ", 1)[1].strip())
    assert "no-such-package-of-sma-bench" in log.read_text()


ONLY = """
import sys
allowed = {*sys.argv[1:], "sma_bench", *sys.stdlib_module_names}
class Only:
    def find_spec(self, name, *_):
        if (top := name.partition(".")[0]) not in allowed and top[0] != "_":
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Only())
import sma_bench.physics.__main__
"""


def run_python(*words: str, cwd: Path = ROOT) -> tuple[int, str]:
    command = [sys.executable, "-c", *words]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_the_physics_compiles_from_what_is_installed_first(bench_script: ModuleType) -> None:
    first = [{"pyyaml": "yaml"}.get(name, name) for name in bench_script.FIRST]
    assert run_python(ONLY, *first) == (0, "")
    assert "ModuleNotFoundError" in run_python(ONLY, *first[:-2])[1]


def test_a_folder_of_its_name_does_not_pass_for_the_package(tmp_path: Path) -> None:
    (tmp_path / "sma_bench" / "sma_bench").mkdir(parents=True)  # the parent of a checkout
    assert run_python("import sma_bench; sma_bench.__version__", cwd=tmp_path) == (0, "")


def test_help_lists_every_command_and_a_wrong_one_gets_a_suggestion_before_any_setup(
    tmp_path: Path,
) -> None:
    house = make_house(tmp_path / "house")
    shutil.copy2(ROOT / COMMANDS_FILE, house / COMMANDS_FILE)
    status, out, err = bench(house)
    assert (status, err) == (0, "")
    assert all(f"\n  {command} " in out for command in ("test", "perf", "check", "python"))
    for name, text in COMMANDS.items():
        said = "" if name in ("demo", "run", "call") else re.escape(text)
        assert re.search(rf"^  {name} .*{said}$", out, re.MULTILINE)
    code, _, err = bench(house, "identfy")
    assert (code, err.count("\n")) == (2, 1) and "did you mean identify?" in err
    assert not list(house.glob(".venv-*"))


# --- What an interrupted setup leaves behind, without the minutes of a real one.


@pytest.fixture
def good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bench_script: ModuleType) -> Any:
    """An environment with runtime and package."""
    house = make_house(tmp_path / "house")
    monkeypatch.setattr(bench_script, "ROOT", house)
    found = bench_script.Environment(house / ".venv")
    (found.path / "bin").mkdir(parents=True)
    found.python.write_text("good")
    done = {stage: bench_script.fingerprint(stage) for stage in ("runtime", "package")}
    found.stamp.write_text(json.dumps(done))
    return found


def ended_by(error: BaseException, half: Path | None = None) -> Any:
    """A step of a setup that ends like this, after it made half of something."""

    def step(what: str, *_: Any) -> None:
        if half is not None:
            half.mkdir(parents=True, exist_ok=True)
        raise error

    return step


def test_an_interrupted_or_killed_setup_never_takes_a_good_environment(good: Any) -> None:
    good._put_aside()
    (good.path / "bin").mkdir(parents=True)
    good.python.write_text("half")
    good._step = ended_by(AssertionError("nothing is to be installed"))
    good.set_up(["runtime", "package"])
    assert good.python.read_text() == "good" and not good.before.exists()
    (good.path.parent / "locks" / "requirements.txt").write_text("mdurl==0.1.1\n")
    for error in (KeyboardInterrupt(), OSError("disk full")):
        good._step = ended_by(error, good.path)
        with pytest.raises(type(error)):
            good.set_up(["runtime", "package"])
        assert good.python.read_text() == "good" and not good.before.exists()
        assert good.missing(["runtime", "package"]) == ["runtime"]


UNUSABLE = {"is Python 3.9": "echo 3.9",
            "does not run": "echo 'pyenv: python3.12: command not found' >&2; exit 127",
            "has no module venv": "exit 1",
            "apt install python3.12-venv": "echo 3.12; exit 1"}  # fmt: skip


@pytest.mark.parametrize("reason", [*UNUSABLE, "there is units", "cannot set up"])
def test_what_cannot_be_done_is_one_line_before_any_setup(reason: str, tmp_path: Path) -> None:
    house, words, python = make_house(tmp_path / "house"), ["x"], sys.executable
    if reason in UNUSABLE:
        python = str(tmp_path / "python3")
        Path(python).write_text(f"#!/bin/sh\n{UNUSABLE[reason]}\n")
        Path(python).chmod(0o755)
    elif reason == "there is units":
        words = ["check", "nonsense"]
    else:  # the folder cannot be written
        (house / f".venv-{sys.version_info[0]}.{sys.version_info[1]}.lock").mkdir()
    code, out, err = bench(house, *words, python=python)
    assert (code, out, err.count("\n")) == (2, "", 1) and reason in err

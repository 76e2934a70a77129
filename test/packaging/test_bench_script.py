"""./bench sets up its environment once, survives interruption, and fails in short words."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sma_bench.commands import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
COMMANDS_FILE = "sma_bench/commands/__init__.py"
COMMAND_LINE = "import sys\nprint(*sys.argv[1:])\nsys.exit(len(sys.argv) - 1)\n"
CHECK = "def main(arguments):\n    print(*arguments)\n    return len(arguments)\n"
SETUP = 'import setuptools\nsetuptools.setup(name="sma_bench", version="0", packages=["sma_bench"])'
NOT_THERE = f"--no-index\nno-such-package-of-sma-bench==1.0 --hash=sha256:{'0' * 64}\n"


def locked(name):
    """The lines of a package in the real locks."""
    locks = "\n".join(path.read_text() for path in sorted((ROOT / "locks").iterdir()))
    return re.search(rf"^{name}==.*\n(?: +--hash=.*\n)+", locks, re.MULTILINE)[0]


def make_house(folder, requirements=None):
    """A checkout whose setup takes seconds; its commands print their arguments and count them."""
    rest = [f"locks/requirements-{name}.txt" for name in ("test", "docs", "perf", "notebook")]
    texts = dict.fromkeys(rest, locked("cycler"))
    texts |= {"locks/requirements.txt": requirements or locked("mdurl"), "setup.py": SETUP}
    texts |= {"sma_bench/cli.py": COMMAND_LINE, "examination/check/units.py": CHECK}
    texts |= dict.fromkeys(("package.xml", "sma_bench/__init__.py", COMMANDS_FILE), "")
    real = ("bench", "locks/requirements-build.txt", "setup.cfg", "pyproject.toml")
    real += ("examination/check/__main__.py",)
    for name, text in (texts | {name: (ROOT / name).read_text() for name in real}).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "bench").chmod(0o755)
    return folder


def start(house, *arguments, python=sys.executable):
    # Byte code of what is only looked at would take most of the time.
    variables = {**os.environ, "BENCH_PYTHON": python, "PIP_NO_COMPILE": "1"}
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE) | {"stdin": subprocess.DEVNULL}
    # Its own process group, so that a test can end it with everything that it started.
    own = {"env": variables, "text": True, "start_new_session": True}
    return subprocess.Popen([house / "bench", *arguments], **streams, **own)


def bench(house, *arguments, **options):
    process = start(house, *arguments, **options)
    out, err = process.communicate()
    return process.returncode, out, err


def environment(house):
    return next(path for path in house.glob(".venv-*") if path.is_dir())


def installed(house):
    return " ".join(p.name for p in environment(house).glob("lib/*/site-packages/*.dist-info"))


@pytest.fixture(scope="module")
def house(tmp_path_factory):
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
    house, monkeypatch
):
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
    assert code == 1 and "sma_bench itself" in err and "setting up" not in err
    assert "sma_bench-1.dist-info" in installed(house)


@pytest.mark.slow
def test_a_package_that_does_not_exist_is_reported_briefly(house, tmp_path):
    made = environment(house)
    house = make_house(tmp_path / "house", NOT_THERE)
    # A copy of an environment, as it takes seconds to make one.
    text, making = (house / "bench").read_text(), '[sys.executable, "-m", "venv", self.path]'
    assert making in text
    (house / "bench").write_text(text.replace(making, f'["cp", "-a", {str(made)!r}, self.path]'))
    code, out, err = bench(house, "x")
    assert (code, out) == (2, "") and "1 packages of requirements.txt: failed" in err
    assert "No matching distribution found for no-such-package-of-sma-bench==1.0" in err
    assert "Traceback" not in err and len(err.splitlines()) < 15
    log = Path(err.rsplit("full log: ", 1)[1].strip())
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


def run_python(*words, cwd=ROOT):
    command = [sys.executable, "-c", *words]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_the_physics_compiles_from_what_is_installed_first(bench_script):
    first = [{"pyyaml": "yaml"}.get(name, name) for name in bench_script.FIRST]
    assert run_python(ONLY, *first) == (0, "")
    assert "ModuleNotFoundError" in run_python(ONLY, *first[:-2])[1]


def test_a_folder_of_its_name_does_not_pass_for_the_package(tmp_path):
    (tmp_path / "sma_bench" / "sma_bench").mkdir(parents=True)  # the parent of a checkout
    assert run_python("import sma_bench; sma_bench.__version__", cwd=tmp_path) == (0, "")


def test_help_lists_every_command_and_a_wrong_one_gets_a_suggestion_before_any_setup(tmp_path):
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


def test_an_interrupted_or_killed_setup_never_takes_a_good_environment(
    tmp_path, monkeypatch, bench_script
):
    """Without the minutes of a real one."""
    house, stages = make_house(tmp_path / "house"), ["runtime", "package"]
    monkeypatch.setattr(bench_script, "ROOT", house)
    good = bench_script.Environment(house / ".venv")
    (good.path / "bin").mkdir(parents=True)
    good.python.write_text("good")
    good.stamp.write_text(json.dumps({stage: bench_script.fingerprint(stage) for stage in stages}))

    def step(*_):
        """What a setup does, half done."""
        good.path.mkdir(exist_ok=True)
        raise error

    good._put_aside()  # a setup that was killed then
    (good.path / "bin").mkdir(parents=True)
    good.python.write_text("half")
    good._step, error = step, AssertionError("nothing is to be installed")
    good.set_up(stages)
    assert good.python.read_text() == "good" and not good.before.exists()
    (house / "locks" / "requirements.txt").write_text("mdurl==0.1.1\n")
    for error in (KeyboardInterrupt(), OSError("disk full")):
        with pytest.raises(type(error)):
            good.set_up(stages)
        assert good.python.read_text() == "good" and not good.before.exists()
        assert good.missing(stages) == ["runtime"]


UNUSABLE = {"is Python 3.9": "echo 3.9",
            "does not run": "echo 'pyenv: python3.12: command not found' >&2; exit 127",
            "has no module venv": "exit 1",
            "apt install python3.12-venv": "echo 3.12; exit 1"}  # fmt: skip


@pytest.mark.parametrize("reason", [*UNUSABLE, "expected one of units", "cannot set up"])
def test_an_impossible_call_is_refused_in_one_line_before_any_setup(reason, tmp_path):
    house, words, python = make_house(tmp_path / "house"), ["x"], sys.executable
    if reason in UNUSABLE:
        python = str(tmp_path / "python3")
        Path(python).write_text(f"#!/bin/sh\n{UNUSABLE[reason]}\n")
        Path(python).chmod(0o755)
    elif reason == "expected one of units":
        words = ["check", "nonsense"]
    else:  # the folder cannot be written
        (house / f".venv-{sys.version_info[0]}.{sys.version_info[1]}.lock").mkdir()
    code, out, err = bench(house, *words, python=python)
    assert (code, out, err.count("\n")) == (2, "", 1) and reason in err

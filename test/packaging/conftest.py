"""./bench as a module, and a checkout of what a commit would hold."""

import shutil
import subprocess
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def bench_script():
    loader = SourceFileLoader("bench_script", str(ROOT / "bench"))
    module = module_from_spec(spec_from_loader("bench_script", loader))
    loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def checkout(tmp_path_factory):
    """Every file that a commit of everything here would hold, to be copied."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    target = tmp_path_factory.mktemp("checkout")
    wanted = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(wanted, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    return target

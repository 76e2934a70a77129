"""Every lock installs as ./bench does it, with an old pip and a new one, whatever is newer.

The index is a folder of empty stand-ins with the names, versions and requirements of the locks, and
beside each a newer version: what an index looks like a month after the locks were written.
"""

import hashlib
import os
import subprocess
import sys
import zipfile
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import NamedTuple

import pytest

from examination.check import pins

ROOT = Path(__file__).resolve().parents[2]
PIPS = {
    "22.3": "1daab4b8d3b97d1d763caeb01a4640a2250a0ea899e257b1e44b9eded91e15ab",
    "26.3": "f3b60b20ffaadd4415ed7957212a38ac63fa4c5fa375bd0f4a797777940fad13",
}
STAGES = ("runtime", "tests", "notebook")
# The versions of a robot, which never meet those of ./bench.
ROBOT = (pins.BUILD, pins.ROBOT, pins.NOBLE)

pytestmark = pytest.mark.slow


def stand_in(folder: Path, package: pins.Locked, version: str) -> str:
    """The hash of a new wheel without content, in its place in an index."""
    stem = f"{package.name.replace('-', '_')}-{version}"
    path = folder / package.name / f"{stem}-py3-none-any.whl"
    path.parent.mkdir(parents=True, exist_ok=True)
    info = f"{stem}.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: {package.name}\nVersion: {version}\n"
    metadata += "".join(f"Requires-Dist: {needed}\n" for needed in package.requires)
    tags = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr(f"{info}/METADATA", metadata)
        wheel.writestr(f"{info}/WHEEL", tags)
        wheel.writestr(f"{info}/RECORD", f"{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")
    with (path.parent / "index.html").open("a") as index:
        index.write(f'<a href="{path.name}">{path.name}</a><br>\n')
    return hashlib.sha256(path.read_bytes()).hexdigest()


class House(NamedTuple):
    """A folder with locks for stand-ins, and the arguments with which ./bench gives them to pip."""

    index: Path
    arguments: dict[str, list[str]]

    def pip(self, pip: Path, python: Path, *arguments: str) -> subprocess.CompletedProcess:
        own = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
        own |= {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": self.index.as_uri(),
                "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_CACHE_DIR": "1"}  # fmt: skip
        command = [python, pip, "install", "--quiet", "--no-compile", *arguments]
        return subprocess.run(
            list(map(str, command)), env=own, capture_output=True, text=True, check=False
        )


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    folder = tmp_path_factory.mktemp("house")
    (folder / "locks").mkdir()
    hashes: dict[tuple[str, str], str] = {}
    for file in pins.BELOW:
        lines = []
        for package in pins.read_lock(pins.LOCKS / file).values():
            key = package.name, package.version
            if key not in hashes:
                hashes[key] = stand_in(folder / "index", package, package.version)
                newer = f"{int(package.version.partition('.')[0]) + 1}.0"
                stand_in(folder / "index", package, newer)
            marker = f" ; {package.marker}" if package.marker else ""
            lines.append(f"{package.name}=={package.version}{marker} --hash=sha256:{hashes[key]}")
        (folder / "locks" / file).write_text("\n".join(lines) + "\n")

    loader = SourceFileLoader("bench_script", str(ROOT / "bench"))
    bench = module_from_spec(spec_from_loader("bench_script", loader))
    loader.exec_module(bench)
    bench.ROOT = folder
    given = {
        requirements.name: arguments
        for stage in STAGES
        for _, arguments, requirements in bench.pip_steps(stage, folder)
    }
    for file in (pins.ROBOT, pins.NOBLE):  # as .ci/noble does
        lock = str(folder / "locks" / file)
        given[file] = ["--no-deps", "--require-hashes", "-r", lock]
    return House(folder / "index", given)


@pytest.fixture(scope="module")
def pip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of this pip, which runs without being installed."""
    version = request.param
    if version == "22.3" and sys.version_info >= (3, 12):
        pytest.skip("pip 22.3 does not run on Python 3.12")
    folder = tmp_path_factory.mktemp("pip")
    (folder / "pip.txt").write_text(f"pip=={version} --hash=sha256:{PIPS[version]}\n")
    fetched = subprocess.run(
        [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "-d", str(folder),
         "-r", str(folder / "pip.txt")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if fetched.returncode:
        pytest.skip(f"pip {version} cannot be fetched: {fetched.stderr.strip()[-200:]}")
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder / version)
    return folder / version / "pip"


def environment(folder: Path) -> Path:
    """The Python of a new environment without anything."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    return folder / "bin" / "python"


def installed(python: Path) -> dict[str, str]:
    folders = python.parents[1].glob("lib/python*/site-packages/*.dist-info")
    stems = (path.name.removesuffix(".dist-info").rsplit("-", 1) for path in folders)
    return {pins.canonical(name): version for name, version in stems}


# A robot's Python 3.12 has no pip 22.3.
@pytest.mark.parametrize(
    ("pip", "robot"), [("22.3", False), ("26.3", False), ("26.3", True)], indirect=["pip"]
)
def test_every_lock_installs_exactly_what_it_pins(
    house: House, pip: Path, tmp_path: Path, robot: bool
) -> None:
    python = environment(tmp_path / "environment")
    files = ROBOT if robot else [file for file in pins.BELOW if file not in pins.UBUNTU]
    for file in files:
        process = house.pip(pip, python, *house.arguments[file])
        assert process.returncode == 0, f"{file}: {process.stderr}"
    assert installed(python) == {
        package.name: package.version
        for file in files
        for package in pins.read_lock(pins.LOCKS / file).values()
        if package.marker is None or package.marker.evaluate()
    }

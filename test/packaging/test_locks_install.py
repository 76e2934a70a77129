"""Every lock installs as ./bench does it, with an old pip and a new one, whatever is newer.

The index is a folder of empty stand-ins with the names, versions and requirements of the locks, and
beside each a newer version: what an index looks like a month after the locks were written.
"""

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from examination.check import pins

PIPS = {
    "22.3": "1daab4b8d3b97d1d763caeb01a4640a2250a0ea899e257b1e44b9eded91e15ab",
    "26.3": "f3b60b20ffaadd4415ed7957212a38ac63fa4c5fa375bd0f4a797777940fad13",
}
# The versions of a robot, which never meet those of ./bench.
ROBOT = (pins.BUILD, pins.ROBOT, pins.NOBLE)

pytestmark = pytest.mark.slow


def stand_in(folder: Path, package: pins.Locked, version: str) -> str:
    """The hash of a new wheel without content, in its place in an index."""
    stem = f"{package.name.replace('-', '_')}-{version}"
    path, info = folder / package.name / f"{stem}-py3-none-any.whl", f"{stem}.dist-info"
    path.parent.mkdir(parents=True, exist_ok=True)
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


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an index of stand-ins, and locks for these."""
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
    return folder


def unpacked_pip(version: str, folder: Path) -> Path:
    """The folder of this pip, which runs without being installed."""
    if version == "22.3" and sys.version_info >= (3, 12):
        pytest.skip("pip 22.3 does not run on Python 3.12")
    (folder / "pip.txt").write_text(f"pip=={version} --hash=sha256:{PIPS[version]}\n")
    options = ["--quiet", "--no-deps", "-d", str(folder), "-r", str(folder / "pip.txt")]
    fetch = [sys.executable, "-m", "pip", "download", *options]
    fetched = subprocess.run(fetch, capture_output=True, text=True, check=False)
    if fetched.returncode:
        pytest.skip(f"pip {version} cannot be fetched: {fetched.stderr.strip()[-200:]}")
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder / version)
    return folder / version / "pip"


# A robot's Python 3.12 has no pip 22.3.
@pytest.mark.parametrize(("version", "robot"), [("22.3", False), ("26.3", False), ("26.3", True)])
def test_every_lock_installs_exactly_what_it_pins(
    house: Path, tmp_path: Path, bench_script: ModuleType, version: str, robot: bool
) -> None:
    pip, target = unpacked_pip(version, tmp_path), tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", target], check=True)
    bench_script.ROOT = house
    stages = ("runtime", "tests", "notebook")
    steps = [step for stage in stages for step in bench_script.pip_steps(stage, house)]
    arguments = {requirements.name: words for _, words, requirements in steps}
    for file in (pins.ROBOT, pins.NOBLE):  # as .ci/noble does
        arguments[file] = ["--no-deps", "--require-hashes", "-r", str(house / "locks" / file)]
    own = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    own |= {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": (house / "index").as_uri()}
    own |= {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_CACHE_DIR": "1"}
    install = [str(target / "bin" / "python"), str(pip), "install", "--quiet", "--no-compile"]

    files = ROBOT if robot else [file for file in pins.BELOW if file not in pins.UBUNTU]
    for file in files:
        command = [*install, *arguments[file]]
        process = subprocess.run(command, env=own, capture_output=True, text=True, check=False)
        assert process.returncode == 0, f"{file}: {process.stderr}"
    # All that they require is there, in a version that fits; .ci/run asks every Python.
    command = [str(target / "bin" / "python"), str(pip), "check"]
    process = subprocess.run(command, env=own, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout
    folders = target.glob("lib/python*/site-packages/*.dist-info")
    stems = (path.name.removesuffix(".dist-info").rsplit("-", 1) for path in folders)
    locked = [package for f in files for package in pins.read_lock(pins.LOCKS / f).values()]
    wanted = [p for p in locked if p.marker is None or p.marker.evaluate()]
    assert {pins.canonical(n): v for n, v in stems} == {p.name: p.version for p in wanted}

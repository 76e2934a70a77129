"""Checks of the lock files: complete, consistent, and without known vulnerabilities.

A requirement file pins versions; its lock in `locks/` adds the hash of every file and the
dependencies; `./bench` installs locks without resolving. Without an option this compares them
offline. `--write` asks the package index again (with uv, which it downloads, and pip); run it after
every change of a requirement file. `--audit` asks for known vulnerabilities (with pip-audit), and
says so if the service cannot be reached.

    ./bench check pins [--write] [--audit]
"""

import json
import re
import subprocess
import sys
import tempfile
from collections import defaultdict, namedtuple
from collections.abc import Sequence
from pathlib import Path

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name as canonical

from examination.pieces import options_of

ROOT = Path(__file__).resolve().parents[2]
LOCKS = ROOT / "locks"
UV, PIP, PIP_AUDIT = "uv==0.13.9", "pip==26.3", "pip-audit==2.10.1"
OLDEST_PYTHON = "3.11"
BUILD, RUNTIME, TEST = "requirements-build.txt", "requirements.txt", "requirements-test.txt"
ROBOT, NOBLE = "requirements-robot.txt", "requirements-noble.txt"
# Files installed before each, whose packages it need not repeat.
BELOW = {BUILD: (), RUNTIME: (BUILD,), TEST: (BUILD, RUNTIME),
         "requirements-docs.txt": (BUILD, RUNTIME, TEST),
         "requirements-perf.txt": (BUILD, RUNTIME, TEST),
         "requirements-notebook.txt": (BUILD, RUNTIME), ROBOT: (), NOBLE: (BUILD, ROBOT)}
# These two have the versions of Ubuntu 24.04 and are never installed together with the others.
UBUNTU = (ROBOT, NOBLE)
_PIN = re.compile(r"^([\w.-]+)==([^\s;\\]+)([^\\\n#]*)", re.MULTILINE)
_HASHED = re.compile(r"^[\w.-]+==.*\\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+", re.MULTILINE)
_BLOCKS = re.compile(r"\n(?=[\w.-]+==)")
_REQUIRES = "    # requires "

# A line of a lock: the pinned package, for which Pythons, and its requirements.
Locked = namedtuple("Locked", "name version marker requires")


def read_lock(path: Path) -> dict[str, Locked]:
    """Packages of a lock, by name; none if there is no such lock."""
    found = {}
    for block in _BLOCKS.split(path.read_text() if path.exists() else ""):
        if pin := _PIN.search(block):
            name, version, marker = canonical(pin[1]), pin[2], pin[3].strip(" ;")
            said = re.findall(rf"^{_REQUIRES}(.*)$", block, re.MULTILINE)
            requires = tuple(Requirement(line) for line in said if not line.startswith("Python "))
            found[name] = Locked(name, version, Marker(marker) if marker else None, requires)
    return found


def problems() -> list[str]:
    """A line for each difference between a lock and its requirement file, or between two locks."""

    def pinned(text: str) -> set[tuple[str, str, str]]:
        """(name, version, marker) of every line, with normalised names and quotes."""
        return {(canonical(name), version,
                 re.sub(r"[\s;'\"]", "", marker).replace("python_full_version", "python_version"))
                for name, version, marker in _PIN.findall(text)}

    found = []
    for path in requirement_files():
        text = (LOCKS / path.name).read_text() if (LOCKS / path.name).exists() else ""
        if path.name not in BELOW:
            found.append(f"{path.name}: not in BELOW of {__file__}")
        wanted, given = pinned(path.read_text()), pinned(text)
        for pins, what in ((wanted - given, "locked"), (given - wanted, "required")):
            found += sorted(f"{path.name}: {n}=={version} is not {what}" for n, version, _ in pins)
        if bare := len(given) - len(_HASHED.findall(text)):
            found.append(f"{path.name}: {bare} without a hash")
    versions: dict[tuple[bool, str], dict[str, str]] = defaultdict(dict)
    for file, below in BELOW.items():
        own = read_lock(LOCKS / file)
        there = {name: p for each in (*below, file) for name, p in read_lock(LOCKS / each).items()}
        python = "3.12" if file in UBUNTU else OLDEST_PYTHON
        place = {"extra": "", "python_version": python, "python_full_version": f"{python}.0"}
        for package in own.values():
            versions[file in UBUNTU, package.name][file] = package.version
            for needed in package.requires:
                markers = filter(None, (package.marker, needed.marker))
                has = there.get(canonical(needed.name))
                fits = has and needed.specifier.contains(has.version, prereleases=True)
                if not fits and all(marker.evaluate(place) for marker in markers):
                    found.append(f"{file}: {package.name} requires {needed}")
    for (_, name), each in sorted(versions.items()):
        if len(set(each.values())) > 1:
            shown = (f"{version} in {file}" for file, version in sorted(each.items()))
            found.append(f"{name}: {', '.join(shown)}")
    return found


def requirement_files() -> list[Path]:
    return sorted(ROOT.glob("requirements*.txt"))


def write_locks(folder: Path) -> int:
    """Ask the index for hashes and requirements of every file; 0 if all locks are written."""
    tools = _tools(folder, UV, PIP)
    LOCKS.mkdir(exist_ok=True)
    texts, metadata = {}, {}
    for path in requirement_files():
        made = folder / path.name
        for command in (
            "uv pip compile --quiet --no-deps --generate-hashes --universal --no-config "
            "--no-header --no-annotate --python-version {python} {path} -o {made}",
            "pip install --quiet --dry-run --ignore-installed --no-deps --report - -r {made}"):
            tool, *words = (word.format(python=OLDEST_PYTHON, path=path, made=made)
                            for word in command.split())  # fmt: skip
            process = subprocess.run([str(tools / tool), *words], capture_output=True, text=True,
                                     check=False)  # fmt: skip
            if process.returncode:
                print(f"pins: {path.name}: {process.stderr.strip()[-300:]}", file=sys.stderr)
                return 1
        texts[path.name] = made.read_text()
        metadata[path.name] = {canonical(package["metadata"]["name"]): package["metadata"]
                               for package in json.loads(process.stdout)["install"]}
    # Only extras that one of the packages here requires.
    extras: dict[str, set[str]] = defaultdict(set)
    for packages in metadata.values():
        for package in packages.values():
            for needed in map(Requirement, package.get("requires_dist", [])):
                extras[canonical(needed.name)] |= needed.extras
    for file, text in texts.items():
        lines = [f"# {file} with hashes; written by ./bench check pins --write."]
        for block in _BLOCKS.split(text.strip("\n")):
            name = canonical(block.partition("==")[0])
            package, lines = metadata[file][name], [*lines, block]
            if package.get("requires_python"):
                lines.append(f"{_REQUIRES}Python {package['requires_python']}")
            for needed in map(Requirement, package.get("requires_dist", [])):
                of = re.findall(r"""extra\s*==\s*["']([^"']+)""", str(needed.marker or ""))
                if not of or extras[name] & set(of):
                    lines.append(f"{_REQUIRES}{needed}")
        (LOCKS / file).write_text("\n".join(lines) + "\n")
        print(f"{file}: {len(metadata[file])} packages locked")
    return 0


def audit(folder: Path) -> int:
    """1 if a vulnerability is known; 0 if none is, or the service cannot be reached."""
    try:
        tool = _tools(folder, PIP_AUDIT) / "pip-audit"
    except subprocess.CalledProcessError:
        print("pins: not audited: pip-audit cannot be fetched")
        return 0
    found = 0
    for path in requirement_files():
        words = "--disable-pip --no-deps --progress-spinner off --timeout 15 --format json -r"
        process = subprocess.run([str(tool), *words.split(), str(LOCKS / path.name)],
                                 capture_output=True, text=True, check=False)
        if not process.stdout.strip():
            last = process.stderr.strip().splitlines()[-1:] or ["no answer"]
            print(f"pins: not audited: the vulnerability service cannot be asked: {last[0][:120]}")
            return 0
        packages = json.loads(process.stdout)["dependencies"]
        known = [package for package in packages if "skip_reason" not in package]
        print(f"{path.name}: the service knows {len(known)} of {len(packages)} packages")
        for name, version, flaw in [(package["name"], package["version"], flaw)
                                    for package in known for flaw in package["vulns"]]:
            mended = ", ".join(flaw["fix_versions"]) or "no version yet"
            print(f"  {name} {version}: {flaw['id']}, mended in {mended}")
            found = 1
    return found


def _tools(folder: Path, *pins: str) -> Path:
    """The bin folder of an environment with only these tools."""
    subprocess.run([sys.executable, "-m", "venv", str(folder / "tool")], check=True)
    tools = folder / "tool" / "bin"
    subprocess.run([tools / "pip", "install", "--quiet", *pins], check=True, capture_output=True)
    return tools


def main(argv: Sequence[str] | None = None) -> int:
    """0 if all locks are complete (and with --audit, no vulnerability is known)."""
    options = options_of("pins", __doc__, argv, write=(False, "ask the package index anew"),
                         audit=(False, "ask for known vulnerabilities"))  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        if options.write and (status := write_locks(Path(folder))):
            return status
        found = problems()
        for line in found:
            print(line)
        if found:
            print("pins: change the requirement files, then ./bench check pins --write")
            return 1
        return audit(Path(folder)) if options.audit else 0

"""The hashes of all that is installed: `locks/` against the requirement files beside it.

A requirement file says which version; its lock adds the hash of every file of that version that the
package index has, for all Pythons and machines: `pip install --require-hashes -r locks/...` refuses
what has been tampered with. Without an option this says, offline, whether the two agree. `--write`
asks the index anew (with uv, fetched for the purpose) and is due after every change of a
requirement file. `--audit` asks for known vulnerabilities (with pip-audit) and, where it cannot
ask, says so.

    ./bench check pins [--write] [--audit]
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LOCKS = ROOT / "locks"
UV, PIP_AUDIT = "uv==0.13.9", "pip-audit==2.10.1"
OLDEST = "3.11"
# .ci/noble's own environment, which takes what a robot has from apt, stays as it is.
UNLOCKED = ("requirements-noble.txt", "requirements-robot.txt")
_PIN = re.compile(r"^([\w.-]+)==([^\s;\\]+)([^\\\n#]*)", re.MULTILINE)
_HASHED = re.compile(r"^[\w.-]+==.*\\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+", re.MULTILINE)


def pinned(text: str) -> set[tuple[str, str, str]]:
    """(name, version, marker) of every line, names and quotes in one form."""
    return {
        (
            re.sub(r"[-_.]+", "-", name).lower(), version,
            re.sub(r"[\s;'\"]", "", marker).replace("python_full_version", "python_version"),
        )
        for name, version, marker in _PIN.findall(text)
    }  # fmt: skip


def disagreements(requirements: Path, lock: Path) -> list[str]:
    """A line for everything in which a lock is not its requirement file with hashes."""
    if not lock.exists():
        return [f"{lock.name}: no lock"]
    wanted, given = pinned(requirements.read_text()), pinned(lock.read_text())
    found = [f"{lock.name}: {name}=={version} is not locked" for name, version, _ in wanted - given]
    found += [f"{lock.name}: {name}=={version} is not required" for name, version, _ in
              given - wanted]  # fmt: skip
    bare = len(given) - len(_HASHED.findall(lock.read_text()))
    return sorted(found) + ([f"{lock.name}: {bare} without a hash"] if bare else [])


def requirement_files() -> list[Path]:
    """Those that have a lock."""
    return [path for path in sorted(ROOT.glob("requirements*.txt")) if path.name not in UNLOCKED]


def write_locks(folder: Path) -> int:
    """Ask the index for every file's hashes; 0 when all locks are written."""
    uv = _tool(UV, folder) / "uv"
    LOCKS.mkdir(exist_ok=True)
    for path in requirement_files():
        made = folder / path.name
        process = subprocess.run(
            [str(uv), "pip", "compile", "--quiet", "--no-deps", "--generate-hashes", "--universal",
             "--no-config", "--no-header", "--no-annotate", "--python-version", OLDEST,
             str(path), "-o", str(made)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if process.returncode:
            print(f"pins: {path.name}: {process.stderr.strip()[-300:]}", file=sys.stderr)
            return 1
        head = f"# {path.name} with hashes; written by ./bench check pins --write.\n"
        (LOCKS / path.name).write_text(head + made.read_text())
        print(f"{path.name}: {len(pinned(made.read_text()))} packages locked")
    return 0


def audit(folder: Path) -> int:
    """1 when a vulnerability is known; 0 when none is, or nobody can be asked."""
    try:
        tool = _tool(PIP_AUDIT, folder) / "pip-audit"
    except subprocess.CalledProcessError:
        print("pins: not audited: pip-audit cannot be fetched")
        return 0
    found = 0
    for path in requirement_files():
        process = subprocess.run(
            [str(tool), "--disable-pip", "--no-deps", "--progress-spinner", "off", "--timeout",
             "15", "--format", "json", "-r", str(LOCKS / path.name)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if not process.stdout.strip():
            last = process.stderr.strip().splitlines()[-1:] or ["no answer"]
            print(f"pins: not audited: the vulnerability service cannot be asked: {last[0][:120]}")
            return 0
        lines = audited(path.name, json.loads(process.stdout)["dependencies"])
        print("\n".join(lines))
        found |= len(lines) > 1
    return found


def audited(name: str, packages: list[dict[str, Any]]) -> list[str]:
    """How many packages of a lock the service knows, then a line for each vulnerability."""
    known = [package for package in packages if "skip_reason" not in package]
    head = f"{name}: {len(known)} of {len(packages)} packages audited"
    if len(known) < len(packages):
        head += ", the others are unknown to the vulnerability service"
    return [head] + [
        f"  {package['name']} {package['version']}: {flaw['id']}, "
        f"mended in {', '.join(flaw['fix_versions']) or 'no version yet'}"
        for package in known
        for flaw in package["vulns"]
    ]


def _tool(pin: str, folder: Path) -> Path:
    """The bin folder of an environment with this tool alone."""
    subprocess.run([sys.executable, "-m", "venv", str(folder / "tool")], check=True)
    pip = folder / "tool" / "bin" / "pip"
    subprocess.run([str(pip), "install", "--quiet", pin], check=True, capture_output=True)
    return folder / "tool" / "bin"


def main(argv: Sequence[str] | None = None) -> int:
    """0 when every requirement is locked (and, asked for it, nothing is known against it)."""
    parser = argparse.ArgumentParser(prog="./bench check pins")
    parser.add_argument("--write", action="store_true", help="ask the package index anew")
    parser.add_argument("--audit", action="store_true", help="ask for known vulnerabilities")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        if options.write and (status := write_locks(Path(folder))):
            return status
        found = [d for path in requirement_files() for d in disagreements(path, LOCKS / path.name)]
        for line in found:
            print(line)
        if found:
            print("pins: run ./bench check pins --write")
            return 1
        return audit(Path(folder)) if options.audit else 0


if __name__ == "__main__":
    sys.exit(main())

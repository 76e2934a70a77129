"""What a commit must pass begins where a newcomer does: with nothing installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# It says where it runs, which environments it sees, and makes one.
BENCH = """#!/bin/sh
echo "$PWD" "$@" .venv*
mkdir -p .venv-made
"""


def test_the_tests_of_a_commit_begin_without_an_environment_and_leave_the_one_here(
    tmp_path: Path,
) -> None:
    house = tmp_path / "house"
    shutil.copytree(ROOT / ".ci", house / ".ci")
    (house / ".ci" / "noble").write_text("#!/bin/sh\n")
    (house / "bench").write_text(BENCH)
    (house / "bench").chmod(0o755)
    (house / ".venv-old").mkdir()
    tools = tmp_path / "tools"  # the Pythons that are here, and no Debian packages to fetch
    tools.mkdir()
    for version in ("3.11", "3.12"):
        (tools / f"python{version}").symlink_to(sys.executable)
    for name in ("apt-get", "dpkg", "ip"):
        (tools / name).symlink_to(shutil.which("true") or "/bin/true")
    process = subprocess.run(
        [house / ".ci" / "run"],
        env={**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "TMPDIR": str(tmp_path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    runs = [line.split() for line in process.stdout.splitlines() if line.startswith("/")]
    folders = {folder for folder, *_ in runs}
    assert len(folders) == 1 and not Path(folders.pop()).exists()
    assert [command for _, command, *_ in runs] == ["test", "notebook", "test", "check"]
    assert runs[0][2:] == [".venv*"]  # as the shell leaves it where there is none
    assert [path.name for path in house.glob(".venv*")] == [".venv-old"]

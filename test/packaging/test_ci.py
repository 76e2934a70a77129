"""What a commit must pass begins where a newcomer does: with nothing installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# It says where it runs, which environments it sees, and makes one.
BENCH = '#!/bin/sh\necho "$PWD" "$@" .venv*\nmkdir -p .venv-made\n'


def test_the_tests_of_a_commit_begin_without_an_environment_and_leave_the_one_here(
    tmp_path: Path,
) -> None:
    house, tools = tmp_path / "house", tmp_path / "tools"
    shutil.copytree(ROOT / ".ci", house / ".ci")
    (house / ".ci" / "noble").write_text("#!/bin/sh\n")
    (house / "bench").write_text(BENCH)
    (house / "bench").chmod(0o755)
    (house / ".venv-old").mkdir()
    tools.mkdir()  # the Pythons that are here, and no Debian packages to fetch
    programs = dict.fromkeys(("python3.11", "python3.12"), sys.executable)
    programs |= dict.fromkeys(("apt-get", "dpkg", "ip"), shutil.which("true") or "/bin/true")
    for name, program in programs.items():
        (tools / name).symlink_to(program)
    given = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "TMPDIR": str(tmp_path)}
    run = [house / ".ci" / "run"]
    process = subprocess.run(run, env=given, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    runs = [line.split() for line in process.stdout.splitlines() if line.startswith("/")]
    (folder,) = {folder for folder, *_ in runs}
    assert not Path(folder).exists()
    assert [command for _, command, *_ in runs] == ["test", "notebook", "test", "check"]
    assert runs[0][2:] == [".venv*"]  # as the shell leaves it where there is none
    assert [path.name for path in house.glob(".venv*")] == [".venv-old"]

"""What is installed has its version and hashes written down."""

from pathlib import Path

import pytest

from examination.check import pins

REQUIREMENTS = 'numpy==2.4.6\nbackports-zstd==1.8.0; python_version < "3.14"  # why\n# pip==1\n'
HASH = "    --hash=sha256:" + "0" * 64
LOCK = (
    f"backports-zstd==1.8.0 ; python_version < '3.14' \\\n{HASH}\n"
    f"numpy==2.4.6 \\\n{HASH} \\\n{HASH}\n"
)


@pytest.mark.parametrize("path", pins.requirement_files(), ids=lambda path: path.name)
def test_every_requirement_is_locked_with_hashes(path: Path) -> None:
    assert pins.disagreements(path, pins.LOCKS / path.name) == [], (
        "run: ./bench check pins --write"
    )


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("", "", []),
        ("2.4.6", "2.4.5", ["numpy==2.4.5 is not required", "numpy==2.4.6 is not locked"]),
        (" ; python_version < '3.14'", "", ["backports-zstd==1.8.0 is not locked",
                                            "backports-zstd==1.8.0 is not required"]),
        (f"numpy==2.4.6 \\\n{HASH} \\\n{HASH}\n", "numpy==2.4.6\n", ["1 without a hash"]),
    ],
)
def test_a_lock_that_is_not_its_requirement_file_is_found(
    tmp_path: Path, old: str, new: str, found: list[str]
) -> None:
    requirements, lock = tmp_path / "r.txt", tmp_path / "lock.txt"
    requirements.write_text(REQUIREMENTS)
    lock.write_text(LOCK.replace(old, new) if old else LOCK)
    assert sorted(pins.disagreements(requirements, lock)) == sorted(f"lock.txt: {f}" for f in found)


def test_the_audit_says_what_it_could_not_ask_about_and_names_each_flaw():
    flaw = {"id": "PYSEC-2030-1", "fix_versions": ["2.1"]}
    packages = [
        {"name": "known", "version": "2.0", "vulns": [flaw, {**flaw, "fix_versions": []}]},
        {"name": "sound", "version": "1.0", "vulns": []},
        {"name": "ros-rcl", "skip_reason": "not found"},
    ]
    assert pins.audited("requirements.txt", packages) == [
        "requirements.txt: 2 of 3 packages audited, the others are unknown to the vulnerability "
        "service",
        "  known 2.0: PYSEC-2030-1, mended in 2.1",
        "  known 2.0: PYSEC-2030-1, mended in no version yet",
    ]
    assert pins.audited("a.txt", packages[1:2]) == ["a.txt: 1 of 1 packages audited"]

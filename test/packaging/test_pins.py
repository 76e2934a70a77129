"""What is installed has its version and hashes written down."""

from pathlib import Path

import pytest

from examination.check import pins

REQUIREMENTS = 'numpy==2.4.6\nbackports-zstd==1.8.0; python_version < "3.14"  # why\n# pip==1\n'
ZSTD = "backports-zstd==1.8.0"
HASH = "    --hash=sha256:" + "0" * 64
LOCK = (
    f"backports-zstd==1.8.0 ; python_version < '3.14' \\\n{HASH}\n"
    f"numpy==2.4.6 \\\n{HASH} \\\n{HASH}\n"
)


def test_every_lock_is_whole_agrees_with_the_others_and_would_install() -> None:
    assert pins.problems() == [], "run: ./bench check pins --write"


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("", "", []),
        ("2.4.6", "2.4.5", ["numpy==2.4.5 is not required", "numpy==2.4.6 is not locked"]),
        (" ; python_version < '3.14'", "", [f"{ZSTD} is not locked", f"{ZSTD} is not required"]),
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


def lock(folder: Path, **packages: str) -> dict[str, pins.Locked]:
    """A lock from versions, each with what it requires behind it: a="1 b>=2, c[d]"."""
    text = ""
    for name, said in packages.items():
        version, _, requires = said.partition(" ")
        text += f"{name}=={version} \\\n{HASH}\n"
        text += "".join(f"    # requires {each}\n" for each in requires.split(", ") if each)
    (folder / "lock.txt").write_text(text)
    return pins.read_lock(folder / "lock.txt")


@pytest.mark.parametrize(
    ("packages", "found"),
    [
        ({"a": "1 B_b>=2", "b-b": "2.1"}, ""),
        ({"a": "1 b>=2"}, "a requires b>=2, which is not locked (Python 3.11, 3.12, 3.13, 3.14)"),
        ({"a": "1 b>=2", "b": "1.9"}, "a requires b>=2, locked is 1.9"),
        ({"a": "1 b; python_version >= '3.13'"}, "which is not locked (Python 3.13, 3.14)"),
        ({"a": "1 b; sys_platform == 'win32'"}, ""),
        ({"a": "1 Python <3.14"}, "a requires Python <3.14 (Python 3.14)"),
        # An extra counts where somebody asks for it.
        ({"b": "1 c; extra == 'more'"}, ""),
        ({"a": "1 b[more]", "b": "1 c; extra == 'more'"}, 'b requires c; extra == "more", which'),
    ],
)
def test_a_lock_that_would_not_install_is_found(
    tmp_path: Path, packages: dict[str, str], found: str
) -> None:
    locks = {file: {} for file in pins.BELOW} | {pins.RUNTIME: lock(tmp_path, **packages)}
    lines = pins.not_installable(pins.RUNTIME, locks)
    assert len(lines) == bool(found) and found in "".join(lines)


def test_locks_of_one_environment_complete_each_other_and_agree(tmp_path: Path) -> None:
    locks = {file: {} for file in pins.BELOW}
    locks |= {pins.RUNTIME: lock(tmp_path, b="2"), pins.TEST: lock(tmp_path, a="1 b>=2")}
    assert pins.not_installable(pins.TEST, locks) == []
    locks[pins.ROBOT] = lock(tmp_path, a="1 b>=2")  # on apt's Python, with none below it
    assert len(pins.not_installable(pins.ROBOT, locks)) == 1
    locks = {pins.RUNTIME: lock(tmp_path, a="1"), pins.NOBLE: lock(tmp_path, a="2")}
    assert pins.conflicts(locks) == []
    locks[pins.TEST] = lock(tmp_path, a="3")
    assert len(pins.conflicts(locks)) == 1 and pins.conflicts(locks)[0].startswith("a: ")


def test_the_audit_says_what_it_could_not_ask_about_and_names_each_flaw():
    flaw = {"id": "PYSEC-2030-1", "fix_versions": ["2.1"]}
    sound, unknown = (
        {"name": "sound", "version": "1.0", "vulns": []},
        {"name": "ros-rcl", "skip_reason": "?"},
    )
    known = {"name": "known", "version": "2.0", "vulns": [flaw, {**flaw, "fix_versions": []}]}
    first, *flaws = pins.audited("requirements.txt", [known, sound, unknown])
    assert first.startswith("requirements.txt: 2 of 3 packages audited")
    assert flaws == [
        "  known 2.0: PYSEC-2030-1, mended in 2.1",
        "  known 2.0: PYSEC-2030-1, mended in no version yet",
    ]
    assert pins.audited("a.txt", [sound]) == ["a.txt: 1 of 1 packages audited"]

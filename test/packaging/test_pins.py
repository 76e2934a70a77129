"""What is installed has its version and hashes written down."""

from pathlib import Path

import pytest

from examination.check import pins

HASH = "    --hash=sha256:" + "0" * 64


def lock(folder: Path, **packages: str) -> dict[str, pins.Locked]:
    """A lock from versions, each with what it requires behind it: a="1 b>=2, c[d]"."""
    text = ""
    for name, said in packages.items():
        version, _, requires = said.partition(" ")
        text += f"{name}=={version} \\\n{HASH}\n"
        text += "".join(f"    # requires {each}\n" for each in requires.split(", ") if each)
    (folder / "lock.txt").write_text(text)
    return pins.read_lock(folder / "lock.txt")


def test_every_lock_is_whole_agrees_with_the_others_and_would_install() -> None:
    assert pins.problems() == [], "run: ./bench check pins --write"


def test_a_lock_that_is_not_its_requirement_file_is_found(tmp_path: Path) -> None:
    requirements, file = tmp_path / "r.txt", tmp_path / "lock.txt"
    requirements.write_text('a==2.4.6\nb==1.8.0; python_version < "3.14"  # why\n# pip==1\n')
    good = f"b==1.8.0 ; python_version < '3.14' \\\n{HASH}\na==2.4.6 \\\n{HASH} \\\n{HASH}\n"
    for old, new, found in (
        ("", "", []),
        ("2.4.6", "2.4.5", ["a==2.4.5 is not required", "a==2.4.6 is not locked"]),
        (" ; python_version < '3.14'", "", ["b==1.8.0 is not locked", "b==1.8.0 is not required"]),
        (f"a==2.4.6 \\\n{HASH} \\\n{HASH}\n", "a==2.4.6\n", ["1 without a hash"]),
    ):
        file.write_text(good.replace(old, new) if old else good)
        said = pins.disagreements(requirements, file)
        assert sorted(said) == sorted(f"lock.txt: {line}" for line in found)


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

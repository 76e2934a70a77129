"""What is installed has its version and hashes written down."""

from pathlib import Path

from examination.check import pins

HASH = "    --hash=sha256:" + "0" * 64


def test_every_lock_is_whole_and_agrees_with_the_others() -> None:
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


def test_locks_of_one_environment_agree(tmp_path: Path) -> None:
    def lock(version: str) -> dict[str, pins.Locked]:
        (tmp_path / "lock.txt").write_text(f"a=={version} \\\n{HASH}\n    # requires b>=2\n")
        return pins.read_lock(tmp_path / "lock.txt")

    locks = {pins.RUNTIME: lock("1"), pins.NOBLE: lock("2")}
    assert pins.conflicts(locks) == []
    locks[pins.TEST] = lock("3")
    assert len(pins.conflicts(locks)) == 1 and pins.conflicts(locks)[0].startswith("a: ")

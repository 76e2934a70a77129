"""What comes from outside is bounded in bytes, depth and time where it enters."""

import contextlib
import os
import stat
import time

import pytest
from test_hostile_bags import MERGED

from sma_bench.border import (
    Budget,
    OverBudget,
    csv_cell,
    is_inside,
    load_yaml,
    printable,
    read_json,
    read_json_object,
    read_yaml,
    write_files,
)
from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically


@pytest.mark.parametrize("text", [
    "[" * 100_000, '{"a":' * 100_000, "[" * 65 + "]" * 65, "9" * 5000, "1e999", "-1e999", "NaN",
    "-Infinity", str(2**63), r'"\ud800"', r'{"\udfff": 1}', "", "{", "\0", " " * (1 << 20) + "1",
])  # fmt: skip
def test_json_that_nothing_can_use_is_one_line(text):
    with pytest.raises(InputError) as refused:
        read_json(text, "recorder/state")
    assert str(refused.value).startswith("recorder/state: ")
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 200


def test_json_of_a_usual_kind_is_read():
    content = {"messages": 3, "share": 0.5, "none": None, "text": "\u00b0\U0001f600", "deep": [[1]]}
    text = (
        '{"messages": 3, "share": 0.5, "none": null, "text": "\u00b0\\ud83d\\ude00", "deep": [[1]]}'
    )
    assert read_json(text, "state") == content == read_json_object(text.encode(), "state")
    with pytest.raises(InputError, match="state: a list, expected a JSON object"):
        read_json_object("[1]", "state")


@pytest.mark.parametrize("text", [
    "a: 0x" + "f" * 5000, f"a: {2**63}", "a: 1" + ":59" * 40, "[" * 3000, "- " * 200 + "1",
    "? " * 200 + "1", 'a: "\\uD800"', "a: &a 1\nb: *a", "{<<: {a: 1}}", "a: !!binary x",
    "a: 2020-13-45", "a: 0o9", "a: 0b", "a: 1:2:x", "!!set 1", "a: \x07", "? [a]\n: 1",
    "a: !!python/object/apply:os.system [id]", "a: !!int x", "a: !!float x", "!!timestamp x",
    "!!bool x", "!!omap {a}", "-0b", "a: +", "x" * (1 << 20) + "x",
])  # fmt: skip
def test_yaml_that_nothing_can_use_is_one_line(text):
    try:
        assert load_yaml(text) is not None  # some of it is a text to YAML
    except InputError as refused:
        assert "\n" not in str(refused) and len(str(refused)) < 200  # noqa: PT017


@pytest.mark.parametrize(("text", "aliases", "said"), [
    ("a: &a 1\nb: *a", False, "not taken"), ("a: " + "9" * 401, False, "64 bits|digits"),
    ("[" * 3000, False, "nested deeper than 64"), (MERGED, True, "merge keys"),
])  # fmt: skip
def test_yaml_is_refused_with_its_reason_in_a_moment(text, aliases, said):
    assert load_yaml("a: &a [1]\nb: *a", aliases=True) == {"a": [1], "b": [1]}
    started = time.thread_time()
    with pytest.raises(InputError, match=said):
        load_yaml(text, aliases=aliases)
    assert time.thread_time() - started < 1.0


def test_long_yaml_is_read_or_refused_in_a_moment():
    # A megabyte is the limit; a quarter of it takes a quarter of the time.
    for text in ("[" + "a," * 125_000 + "]", "- " * 60 + "{a: b}", "? a\n" * 60_000):
        started = time.thread_time()
        with contextlib.suppress(InputError):
            load_yaml(text)
        assert time.thread_time() - started < 2.5


def test_a_pipe_or_a_device_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    for path in (tmp_path / "pipe.yaml", "/dev/zero", "/dev/null"):
        with pytest.raises(InputError, match="expected a regular file"):
            read_yaml(path)
    with pytest.raises(InputError, match="Is a directory"):
        read_yaml(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_yaml(f"{tmp_path}/a\0b")
    (tmp_path / "big.yaml").write_bytes(b"#" * ((1 << 20) + 1))
    with pytest.raises(InputError, match="larger than 1048576 bytes"):
        read_yaml(tmp_path / "big.yaml")


def test_a_budget_ends_by_bytes_and_by_time():
    budget = Budget(10 << 20, 100.0)
    budget.take(10 << 20)
    with pytest.raises(OverBudget, match="unfolds to more than 10 MB"):
        budget.take(1)
    late = Budget(10, 0.0)
    while not late.is_over():
        pass
    with pytest.raises(OverBudget, match="takes more than 0 s"):
        late.take(1)


def test_names_do_nothing_to_a_terminal_or_a_spreadsheet():
    assert printable("wire \u00b0C \u00e9") == "wire \u00b0C \u00e9"
    assert printable("\x1b[2J\r\n\x9b\u202e\udcff") == "\\x1b[2J\\r\\n\\x9b\\u202e\\udcff"
    assert printable("a\nb", keep="\n") == "a\nb"
    for text in ("=1+1", "+cmd|x", "-2+3", "@SUM(A1)"):
        assert csv_cell(text) == "'" + text
    assert csv_cell("\t=1") == "\\t=1"
    for text in ("-3.2", "+1e-4", "-inf", "nan", "E1", ""):
        assert csv_cell(text) == text


def test_links_are_followed_before_a_path_is_judged(tmp_path):
    inside = tmp_path / "root"
    inside.mkdir()
    (inside / "out").symlink_to(tmp_path)
    (inside / "circle").symlink_to("circle")
    assert is_inside(inside / "a" / ".." / "b", inside)
    assert not is_inside(inside / ".." / "root2", inside)
    assert not is_inside(inside / "out" / "x", inside)
    assert not is_inside(inside / "a\0b", inside)


def test_a_replaced_file_keeps_its_mode_and_its_link(tmp_path):
    (tmp_path / "kept").mkdir()
    target = tmp_path / "kept" / "lab.yaml"
    target.write_text("old")
    target.chmod(0o640)
    link = tmp_path / "lab.yaml"
    link.symlink_to("kept/lab.yaml")
    write_text_atomically(link, "new \udcff")
    assert link.is_symlink() and target.read_text() == "new \\udcff"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["kept", "lab.yaml", "lab.yaml"]


def test_files_are_replaced_together_or_not_at_all(tmp_path, monkeypatch):
    first, second, third = (tmp_path / name for name in ("a", "b", "c"))
    first.write_text("old a")
    second.write_text("old b")
    replace, calls = os.replace, []

    def fail_at_the_last(source, target):
        calls.append(target)
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        return replace(source, target)

    monkeypatch.setattr(os, "replace", fail_at_the_last)
    with pytest.raises(OSError, match="No space"):
        write_files({third: b"new", first: b"new", second: b"new"})
    assert (first.read_text(), second.read_text()) == ("old a", "old b")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
    monkeypatch.undo()
    third.mkdir()
    with pytest.raises(OSError, match="something else than a file"):
        write_files({first: b"new", third: b"new"})
    assert first.read_text() == "old a"

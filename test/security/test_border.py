"""External input is bounded in bytes, depth and time where it enters; texts from topics are bounded
and typed, or ignored."""

import contextlib
import json
import math
import os
import stat
import time

import pytest
from hostile_texts import MERGED, hostile

from sma_bench import border
from sma_bench.dashboard.live_state import LiveState, Seen, result_summary
from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_failure, recorder_state
from sma_bench.parameters.yaml_file import write_text_atomically


@contextlib.contextmanager
def one_line(begin=""):
    """Read, or refused with a short line."""
    try:
        yield
    except InputError as refused:
        said = str(refused)
        assert said.startswith(begin) and "\n" not in said and len(said) < 200, said


def test_json_that_nothing_can_use_is_one_line_and_of_a_usual_kind_is_read():
    for text in hostile("json"):
        with one_line("recorder/state: "):
            border.read_json(text, "recorder/state")
            pytest.fail(f"{text[:50]} was read")
    content = {"messages": 3, "share": 0.5, "none": None, "text": "\u00b0\U0001f600", "deep": [[1]]}
    text = json.dumps(content, ensure_ascii=True)
    assert border.read_json(text, "state") == content
    assert border.read_json_object(text.encode(), "state") == content
    with pytest.raises(InputError, match="state: a list, expected a JSON object"):
        border.read_json_object("[1]", "state")


def test_yaml_that_nothing_can_use_is_one_line():
    for text in hostile("yaml"):
        with one_line():
            assert border.load_yaml(text) is not None  # some of it is a text to YAML


def test_yaml_is_read_or_refused_with_its_reason_in_a_moment():
    assert border.load_yaml("a: &a [1]\nb: *a", aliases=True) == {"a": [1], "b": [1]}
    # The limit is a megabyte; a quarter of it takes a quarter of the time.
    for text, aliases, said in (
        ("a: &a 1\nb: *a", False, "not supported"), ("a: " + "9" * 401, False, "64 bits|digits"),
        ("[" * 3000, False, "nested deeper than 64"), (MERGED, True, "merge keys"),
        ("[" + "a," * 125_000 + "]", False, ""), ("- " * 60 + "{a: b}", False, ""),
        ("? a\n" * 60_000, False, ""),
    ):  # fmt: skip
        started = time.thread_time()
        with pytest.raises(InputError, match=said) if said else contextlib.suppress(InputError):
            border.load_yaml(text, aliases=aliases)
        assert time.thread_time() - started < 2.5, text[:20]


def test_a_pipe_or_a_device_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "big.yaml").write_bytes(b"#" * ((1 << 20) + 1))
    regular = "expected a regular file"
    for path, said in (
        (tmp_path / "pipe.yaml", regular), ("/dev/zero", regular), ("/dev/null", regular),
        (tmp_path, "Is a directory"), (f"{tmp_path}/a\0b", "no such file"),
        (tmp_path / "big.yaml", "larger than 1048576 bytes"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            border.read_yaml(path)


def test_a_budget_ends_by_bytes_and_by_time():
    budget = border.Budget(10 << 20, 100.0)
    budget.take(10 << 20)
    with pytest.raises(border.OverBudget, match="unfolds to more than 10 MB"):
        budget.take(1)
    late = border.Budget(1 << 30, 0.0)
    while not late.is_over():
        pass
    with pytest.raises(border.OverBudget, match="takes more than 0 s"):
        late.take(1 << 29)  # it looks at the time now and then only


def test_names_do_nothing_to_a_terminal_or_a_spreadsheet():
    assert border.printable("wire \u00b0C \u00e9") == "wire \u00b0C \u00e9"
    assert border.printable("\x1b[2J\r\n\x9b\u202e\udcff") == "\\x1b[2J\\r\\n\\x9b\\u202e\\udcff"
    assert border.printable("a\nb", keep="\n") == "a\nb"
    for text in ("=1+1", "+cmd|x", "-2+3", "@SUM(A1)"):
        assert border.csv_cell(text) == "'" + text
    assert border.csv_cell("\t=1") == "\\t=1"
    for text in ("-3.2", "+1e-4", "-inf", "nan", "E1", ""):
        assert border.csv_cell(text) == text


def test_links_are_followed_before_a_path_is_judged(tmp_path):
    inside = tmp_path / "root"
    inside.mkdir()
    (inside / "out").symlink_to(tmp_path)
    (inside / "circle").symlink_to("circle")
    assert border.is_inside(inside / "a" / ".." / "b", inside)
    for path in ("../root2", "out/x", "a\0b"):
        assert not border.is_inside(inside / path, inside)


def test_files_are_replaced_together_or_not_at_all_and_keep_mode_and_link(tmp_path, monkeypatch):
    link, target = tmp_path / "lab.yaml", tmp_path / "kept" / "lab.yaml"
    target.parent.mkdir()
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to("kept/lab.yaml")
    write_text_atomically(link, "new \udcff")
    assert link.is_symlink() and target.read_text() == "new \\udcff"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["kept", "lab.yaml", "lab.yaml"]

    folder = tmp_path / "together"
    folder.mkdir()
    first, second, third = (folder / name for name in "abc")
    first.write_text("old a")
    second.write_text("old b")
    replace, calls = os.replace, []

    def fail_at_the_last(source, target):
        calls.append(target)
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        return replace(source, target)

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
        patch.setattr(os, "replace", fail_at_the_last)
        border.write_files({third: b"new", first: b"new", second: b"new"})
    found = {path.name: path.read_text() for path in folder.iterdir()}
    assert found == {"a": "old a", "b": "old b"}
    third.mkdir()
    with pytest.raises(OSError, match="something other than a file"):
        border.write_files({first: b"new", third: b"new"})
    assert first.read_text() == "old a"


# --- texts on topics (for their use by nodes and pages see test/nodes/test_dashboard.py) ----------


@pytest.mark.parametrize("text", hostile("topics"), ids=lambda text: text[:20].encode().hex())
def test_a_hostile_text_is_read_or_refused_in_one_line(text):
    ros = pytest.importorskip("sma_bench.ros.dashboard", reason="ROS 2 is not installed")
    assert len(recorder_failure(text)) <= 501
    state = recorder_state(text)
    assert state is None or all(isinstance(n, int) for n in state["messages"].values())
    result = json.dumps(result_summary("diagnosis", text), allow_nan=False)
    for line in (ros.state_line(text), result):
        assert "\x1b" not in line and "\n" not in line and len(line) < 20_000
    numbers = {"elapsed": border.NUMBER, "duration": border.NUMBER_OR_NULL}
    fields = {"protocol": border.TEXT, "step": border.TEXT, **numbers}
    with one_line():
        progress = border.read_fields(text, fields, "experiment/progress")
        assert all(isinstance(progress[name], str) for name in ("protocol", "step"))
        assert math.isfinite(progress["elapsed"])
        assert progress["duration"] is None or math.isfinite(progress["duration"])


def test_what_people_and_pages_see_of_hostile_texts_is_short_and_bounded():
    assert border.shown("a\n b\x1b[2J") == "a b\\x1b[2J"
    assert len(border.shown("x" * 10**6)) == 501
    state = LiveState()
    for k in range(10_000):
        state.reading("voltage", f"wire_{k}", 1.0)
    for k in range(1000):
        state.merge("diagnostics", {f"node_{k}": {}})
    update = state.update(Seen())
    assert len(update["signals"]) == 300 and len(update["panels"]["diagnostics"]) == 200

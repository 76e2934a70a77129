"""A damaged bag is read up to the damage, or refused, and what was lost is reported."""

import random
import shutil
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.border import reading_budget
from sma_bench.errors import InputError
from sma_bench.records import bag, contract, read_record


@pytest.fixture
def mcap(tmp_path, write_bag, ramp):
    """Uncompressed, eight chunks of 50 messages."""
    return next(write_bag(tmp_path / "bag", ramp, chunk=50).glob("*.mcap"))


def voltages(record):
    return np.rint(record["wire.voltage"].values * 1000).astype(int).tolist()


def losses(record, subject):
    """Warnings about a file or topic."""
    return [f for f in record.findings if f.subject == subject and f.severity == "warning"]


def require_one_line(path, *named):
    """Asserts that reading fails with one line that names the file and contains all of `named`."""
    with pytest.raises(InputError) as refused:
        read_record(path)
    line = str(refused.value)
    assert "\n" not in line and str(path) in line
    assert all(text in line for text in named)


def test_a_db3_whose_pages_form_a_loop_is_refused_with_a_remedy(tmp_path, write_bag, messages):
    """The root page of the message table, which lists all leaf pages, lists the third one again and
    again: such a file once gave rows until the memory was full."""
    content = [("/b/wire/temperature", messages.temperature(stamp, 20.0), stamp)
               for stamp in range(messages.start, messages.start + 3000 * 10**7, 10**7)]
    file = next(write_bag(tmp_path / "bag", content, "sqlite3").glob("*.db3"))
    raw = bytearray(file.read_bytes())
    root = max((at for at in range(0, len(raw), 4096) if raw[at] == 0x05),
               key=lambda at: struct.unpack_from(">H", raw, at + 3)[0])
    (cells,) = struct.unpack_from(">H", raw, root + 3)
    pointers = struct.unpack_from(f">{cells}H", raw, root + 12)
    first = raw[root + pointers[2] : root + pointers[2] + 4]
    for pointer in pointers[cells // 2 :]:
        raw[root + pointer : root + pointer + 4] = first
    raw[root + 8 : root + 12] = first
    file.write_bytes(bytes(raw))
    require_one_line(file, f"sqlite3 {file.name} .recover")


def test_a_write_ahead_log_beside_a_db3_is_reported_and_not_touched(tmp_path, write_bag, ramp):
    """A recorder that uses it leaves the last messages in it when it dies."""
    db3 = next(write_bag(tmp_path / "bag", ramp, "sqlite3").glob("*.db3"))
    died = tmp_path / "died"
    died.mkdir()
    with closing(sqlite3.connect(db3)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("DELETE FROM messages WHERE id > 100")
        database.commit()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 1, x'00')")
        database.commit()
        for file in db3.parent.iterdir():
            shutil.copy(file, died / file.name)
    before = {file.name: file.read_bytes() for file in died.iterdir()}
    record = read_record(died)
    assert voltages(record) == list(range(50))
    assert losses(record, db3.name) and losses(record, "/bench/wire/power")
    assert {file.name: file.read_bytes() for file in died.iterdir()} == before


def test_a_path_without_anything_readable_gives_one_line(tmp_path, mcap, write_bag):
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.txt").write_bytes(b"no bag")
    (tmp_path / "zero.mcap").write_bytes(b"")
    (tmp_path / "noise.db3").write_bytes(random.Random(0).randbytes(5000))
    write_bag(tmp_path / "empty", [], declare=[("/b/t", "std_msgs/msg/String")])
    for name in ("absent", "empty", "folder", "notes.txt", "zero.mcap", "noise.db3"):
        require_one_line(tmp_path / name)
    write_bag(tmp_path / "folder" / "bag", [], declare=[("/b/t", "std_msgs/msg/String")])
    require_one_line(tmp_path / "folder", "a folder of bags")
    mcap.unlink()
    require_one_line(mcap.parent, "bag.mcap")


# --- messages (test_read_bags checks that they are decoded as rosbags does)


def decoded(blobs, kind):
    lengths = np.array([len(blob) for blob in blobs], dtype=np.int64)
    return list(bag.decode(b"".join(blobs), lengths, bag.FIELDS[kind], reading_budget(0)))


@settings(max_examples=100, deadline=None)
@given(blobs=st.lists(st.binary(max_size=80), max_size=6), kind=st.sampled_from(sorted(bag.FIELDS)),
       prefix=st.sampled_from([b"", b"\0\0\0\0", b"\0\1\0\0"]))  # fmt: skip
def test_random_bytes_are_decoded_or_left_out(blobs, kind, prefix):
    blobs = [prefix + blob for blob in blobs]
    rows = [row for batch in decoded(blobs, kind) for row in batch.rows.tolist()]
    assert len(rows) == len(set(rows)) <= len(blobs)


def test_encoded_messages_are_decoded_and_truncated_ones_left_out(messages):
    arrays = {"position": np.array([1.0, 2.0]), "effort": np.array([3.0, 4.0])}
    template = messages.serialise(messages.stamped("JointState", 5, name=["tip", "wire"], **arrays))
    cut = [template[:length] for length in range(len(template))]
    assert decoded(cut, contract.JOINT_STATE) == []
    values = np.arange(6.0).reshape(3, 2)
    blobs = bag.encode(template, contract.JOINT_STATE, {"effort": values})
    for blob, row in zip(blobs, values, strict=True):
        message = messages.types.deserialize_cdr(blob, contract.JOINT_STATE)
        assert message.effort.tolist() == row.tolist() and message.name == ["tip", "wire"]
    with pytest.raises(bag.CdrError):
        bag.encode(template, contract.JOINT_STATE, {"effort": np.zeros((3, 1))})

"""A damaged bag is read up to the damage, or refused, and what was lost is said."""

import os
import random
import shutil
import sqlite3
import struct
import zlib
from contextlib import closing

import numpy as np
import pytest
from rosbags.rosbag2.enums import CompressionMode

from sma_bench.errors import InputError
from sma_bench.records import describe, read_record


@pytest.fixture
def mcap(tmp_path, write_bag, ramp):
    """Uncompressed, eight chunks of 50 messages."""
    return next(write_bag(tmp_path / "bag", ramp, chunk=50).glob("*.mcap"))


def voltages(record):
    return np.rint(record["wire.voltage"].values * 1000).astype(int).tolist()


def losses(record, subject):
    """What is said of a file or topic, as warnings."""
    return [f for f in record.findings if f.subject == subject and f.severity == "warning"]


def chunks_of(content):
    """Offsets of the chunk records of an mcap file, and of what ends its data."""
    found, position = [], 8
    while content[position] != 0x0F:
        opcode, length = struct.unpack_from("<BQ", content, position)
        found += [position] if opcode == 6 else []
        position += 9 + length
    return found, position


def require_one_line(path, *named):
    """That reading is refused in one line that names the file, and says all of `named`."""
    with pytest.raises(InputError) as refused:
        read_record(path)
    line = str(refused.value)
    assert "\n" not in line and str(path) in line
    assert all(text in line for text in named)


@pytest.mark.parametrize("chunks", [1, 7, 8])
def test_truncated_mcap_is_read_up_to_the_last_whole_chunk(mcap, chunks):
    content = mcap.read_bytes()
    starts, end = chunks_of(content)
    # Of the last: the writer died after it, before what would have ended the file.
    cut = starts[chunks] + 100 if chunks < 8 else content.rindex(b"\x0c", 0, end)
    mcap.write_bytes(content[:cut])
    for path in (mcap, mcap.parent):
        record = read_record(path)
        assert voltages(record) == list(range(25 * chunks))
        (lost,) = losses(record, "bag.mcap")
        assert chunks == 8 or lost.numbers["bytes"] > 0
    missing = [f.numbers for f in losses(record, "/bench/wire/power")]
    assert missing == [{"missing": 200 - 25 * chunks, "announced": 200}] * (chunks < 8)


@pytest.mark.parametrize("damage", ["garbage", "bit", "zeros"])
def test_what_lies_behind_damage_is_given_up_and_said(mcap, damage):
    content = bytearray(mcap.read_bytes())
    third = chunks_of(content)[0][3]
    if damage != "bit":
        bad = {"garbage": random.Random(0).randbytes(2000), "zeros": bytes(2000)}[damage]
        content[third : third + 2000] = bad
    else:  # rosbags writes no checksums: put one there, then alter a bit
        start = third + 9
        (size,) = struct.unpack_from("<Q", content, start + 16)
        data = start + struct.calcsize("<QQQII") + 8
        struct.pack_into("<I", content, start + 24, zlib.crc32(content[data : data + size]))
        content[data + 1500] ^= 1
    mcap.write_bytes(bytes(content))
    record = read_record(mcap.parent)
    assert voltages(record) == list(range(75))
    (lost,) = losses(record, "bag.mcap")
    assert lost.numbers["bytes"] == len(content) - third
    assert len(losses(record, "/bench/wire/power")) == 1


def test_a_channel_without_a_schema_is_no_damage(mcap):
    content = mcap.read_bytes()
    topic, encoding = b"/log", b"json"
    channel = struct.pack("<HHI", 999, 0, len(topic)) + topic
    channel += struct.pack("<I", len(encoding)) + encoding + struct.pack("<I", 0)
    message = struct.pack("<HIQQ", 999, 0, 5, 5) + b"{}"
    extra = b"".join(
        struct.pack("<BQ", code, len(r)) + r for code, r in ((4, channel), (5, message))
    )
    first = chunks_of(content)[0][0]
    mcap.write_bytes(content[:first] + extra + content[first:])
    record = read_record(mcap)
    assert voltages(record) == list(range(200)) and not losses(record, "bag.mcap")


@pytest.mark.parametrize("damage", ["zeroed", "cut", "circle"])
def test_a_damaged_db3_is_refused_naming_what_saves_it(tmp_path, write_bag, messages, damage):
    content = []
    for k in range(3000):
        stamp = messages.start + k * 10_000_000
        content.append(("/b/wire/temperature", messages.temperature(stamp, 20 + k), stamp))
    file = next(write_bag(tmp_path / "bag", content, "sqlite3").glob("*.db3"))
    raw = bytearray(file.read_bytes())
    if damage == "zeroed":
        page = raw.find(messages.serialise(content[1500][1])) // 4096
        raw[page * 4096 : (page + 1) * 4096] = bytes(4096)
    elif damage == "cut":
        raw = raw[: int(len(raw) * 0.6) // 4096 * 4096]
    else:
        # The root of the message table, an interior page that names all the leaves, leads back:
        # it once gave its rows for ever, until the memory was full.
        root = max(
            (at for at in range(0, len(raw), 4096) if raw[at] == 0x05),
            key=lambda at: struct.unpack_from(">H", raw, at + 3)[0],
        )
        (cells,) = struct.unpack_from(">H", raw, root + 3)
        pointers = [struct.unpack_from(">H", raw, root + 12 + 2 * k)[0] for k in range(cells)]
        first = raw[root + pointers[2] : root + pointers[2] + 4]
        for pointer in pointers[cells // 2 :]:
            raw[root + pointer : root + pointer + 4] = first
        raw[root + 8 : root + 12] = first
    file.write_bytes(bytes(raw))
    require_one_line(file, f"sqlite3 {file.name} .recover")


def test_a_write_ahead_log_beside_a_db3_is_said_and_left_alone(tmp_path, write_bag, ramp):
    """Recorders that use sqlite's log leave the last messages in it when they die."""
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


def test_broken_messages_of_a_message_compressed_bag_are_counted(tmp_path, write_bag, ramp):
    bag = write_bag(tmp_path / "bag", ramp, "sqlite3", CompressionMode.MESSAGE)
    with closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
        database.execute("UPDATE messages SET data = substr(data, 1, 20) WHERE id IN (5, 9)")
        database.commit()
    record = read_record(bag)
    assert len(record["wire.voltage"]) == 198
    assert [f.numbers for f in losses(record, "/bench/wire/power")] == [{"messages": 2}]


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
BOMB += (
    "rosbag2_bagfile_information:\n  relative_file_paths: [bag.mcap]\n"
    "  topics_with_message_count: [{topic_metadata: {name: NAME}, message_count: COUNT}]\n"
)
METADATA = {"an open brace": "{", "a number": "rosbag2_bagfile_information: 3", "zeros": "\0\0"}
METADATA |= {"nothing": "", "names without end": BOMB.replace("NAME", "*a11")}
METADATA["counts without end"] = BOMB.replace("NAME", "/b/t").replace("COUNT", "*a11")


@pytest.mark.parametrize("what", METADATA)
def test_unreadable_metadata_does_not_hide_the_storage_file(mcap, what):
    (mcap.parent / "metadata.yaml").write_text(METADATA[what].replace("COUNT", "1"))
    record = read_record(mcap.parent)
    assert voltages(record) == list(range(200)) and losses(record, "metadata.yaml")


def test_nothing_readable_is_one_line(tmp_path, mcap, write_bag):
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.txt").write_bytes(b"no bag")
    (tmp_path / "zero.mcap").write_bytes(b"")
    (tmp_path / "noise.db3").write_bytes(random.Random(0).randbytes(5000))
    write_bag(tmp_path / "empty", [], declare=[("/b/t", "std_msgs/msg/String")])
    for name in ("absent", "empty", "folder", "notes.txt", "zero.mcap", "noise.db3"):
        require_one_line(tmp_path / name)
    mcap.unlink()
    require_one_line(mcap.parent, "bag.mcap")


DAMAGES = {
    "flip": lambda rng, raw, at, n: raw[:at] + rng.randbytes(min(n, 8)) + raw[at + min(n, 8) :],
    "zero": lambda rng, raw, at, n: raw[:at] + bytes(min(n, len(raw) - at)) + raw[at + n :],
    "cut": lambda rng, raw, at, n: raw[:at],
    "insert": lambda rng, raw, at, n: raw[:at] + rng.randbytes(n) + raw[at:],
    "delete": lambda rng, raw, at, n: raw[:at] + raw[at + n :],
    "garbage": lambda rng, raw, at, n: raw[:at] + rng.randbytes(n) + raw[at + n :],
}
STORED = [("mcap", mode) for mode in CompressionMode]
STORED += [("sqlite3", mode) for mode in (CompressionMode.NONE, CompressionMode.FILE)]
_REPEATS = 12  # ./bench check bags draws hundreds


@pytest.mark.parametrize(("storage", "mode"), STORED)
def test_any_damage_ends_in_a_record_or_one_line(tmp_path, write_bag, ramp, storage, mode):
    original = write_bag(tmp_path / "bag", ramp, storage, mode)
    copy, rng = tmp_path / "copy", random.Random(f"{storage} {mode}")
    for damage in list(DAMAGES) * _REPEATS:
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(original, copy)
        stored = next(p for p in copy.iterdir() if p.name != "metadata.yaml")
        file = stored if rng.random() < 0.8 else copy / "metadata.yaml"
        raw = file.read_bytes()
        at = rng.randrange(len(raw) if rng.random() < 0.8 else min(300, len(raw)))
        file.write_bytes(DAMAGES[damage](rng, raw, at, rng.choice([1, 30, 4096, 9000])))
        try:
            record = read_record(copy)
        except InputError as error:
            assert "\n" not in str(error)
        else:
            describe(record)
            assert all("\n" not in str(finding) for finding in record.findings)


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.STORAGE])
def test_whole_messages_of_the_chunk_that_a_file_ends_in_are_read(tmp_path, write_bag, ramp, mode):
    bag = write_bag(tmp_path / "bag", ramp, "mcap", mode, chunk=1 << 20)
    storage = next(bag.glob("*.mcap"))
    os.truncate(storage, storage.stat().st_size // 2)
    voltage = read_record(bag)["wire.voltage"].values
    assert len(voltage) > 20
    np.testing.assert_allclose(voltage, np.arange(len(voltage)) * 1e-3, atol=1e-8)

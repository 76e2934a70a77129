"""A damaged bag is read up to, around and after the damage, and what was lost is said."""

import random
import shutil
import sqlite3
import struct
import zlib

import numpy as np
import pytest
from rosbags.rosbag2.enums import CompressionMode

from sma_bench.errors import InputError
from sma_bench.records import describe, read_record


@pytest.fixture
def mcap(tmp_path, write_bag, ramp):
    """Uncompressed, eight chunks of 50 messages."""
    return next(write_bag(tmp_path / "bag", ramp, chunk=50).glob("*.mcap"))


@pytest.fixture
def db3(tmp_path, write_bag, ramp):
    return next(write_bag(tmp_path / "bag", ramp, "sqlite3").glob("*.db3"))


@pytest.fixture
def temperature_bag(tmp_path, write_bag, messages):
    """Writes a bag of one temperature topic: temperature_bag(celsius, period_ns, storage, ...)."""

    def write(celsius, period, *storage, **options):
        stamps = [messages.start + k * period for k in range(len(celsius))]
        content = [
            ("/b/wire/temperature", messages.temperature(stamp, value), stamp)
            for stamp, value in zip(stamps, celsius, strict=True)
        ]
        return write_bag(tmp_path / "bag", content, *storage, **options)

    return write


def voltages(record):
    return np.rint(record["wire.voltage"].values * 1000).astype(int).tolist()


def findings(record):
    return " | ".join(f"{f.subject}: {f.text}" for f in record.findings)


@pytest.mark.parametrize("fraction", [0.3, 0.5, 0.72])
def test_truncated_mcap_is_read_up_to_the_cut(mcap, fraction):
    content = mcap.read_bytes()
    cut = int(len(content) * fraction)
    mcap.write_bytes(content[:cut])
    for path in (mcap, mcap.parent):
        record = read_record(path)
        found = voltages(record)
        assert found == list(range(len(found)))
        # The messages proper take up about three quarters of this small file.
        assert len(found) > 200 * fraction * 0.9
        assert "damaged" in findings(record) or "never finished" in findings(record)
    lost = 200 - len(found)
    text = f"{lost} of 200 messages ({lost / 200:.1%}) announced by metadata.yaml cannot be read"
    assert text in findings(record)


def test_truncated_compressed_chunk_gives_what_its_blocks_hold(temperature_bag):
    celsius = np.random.default_rng(0).normal(size=20_000)
    bag = temperature_bag(celsius, 1_000_000, compression=CompressionMode.STORAGE)
    file = next(bag.glob("*.mcap"))
    whole = file.read_bytes()
    # Half the file is the index of the first chunk.
    file.write_bytes(whole[: len(whole) // 4])
    record = read_record(bag)
    assert 5_000 < len(record["wire.temperature"]) < 20_000
    assert "the file ends inside the chunk" in findings(record)


def test_mcap_whose_writer_died_between_chunks_is_whole(mcap):
    content = mcap.read_bytes()
    end = content.index(b"\x0f" + struct.pack("<Q", 4))  # DataEnd
    before_metadata = content.rindex(b"\x0c", 0, end)
    mcap.write_bytes(content[:before_metadata])
    record = read_record(mcap)
    assert len(record["wire.voltage"]) == 200
    assert "never finished" in findings(record)


def test_garbage_in_the_middle_of_an_mcap_costs_only_what_it_hits(mcap):
    content = bytearray(mcap.read_bytes())
    middle = len(content) // 3
    content[middle : middle + 2000] = random.Random(0).randbytes(2000)
    mcap.write_bytes(bytes(content))
    record = read_record(mcap.parent)
    found = voltages(record)
    assert set(found) <= set(range(200)) and 180 <= len(found) < 200
    assert "make no sense" in findings(record)
    assert found[0] == 0 and found[-1] == 199


def test_mcap_with_a_damaged_beginning_learns_its_topics_from_the_index(mcap):
    content = bytearray(mcap.read_bytes())
    content[: content.index(b"\x05", 3000)] = bytes(content.index(b"\x05", 3000))
    mcap.write_bytes(bytes(content))
    record = read_record(mcap)
    assert len(record["wire.voltage"]) > 170


def test_chunk_with_a_wrong_checksum_is_left_out(mcap):
    content = bytearray(mcap.read_bytes())
    chunks = []
    position = 8
    while content[position] != 0x0F:
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 6:
            chunks.append((position, length))
        position += 9 + length
    for at, length in chunks:
        data = content[at + 9 + 40 : at + 9 + length]
        struct.pack_into("<I", content, at + 9 + 24, zlib.crc32(data))
    mcap.write_bytes(bytes(content))
    assert read_record(mcap).findings == ()
    at, length = chunks[3]
    content[at + 9 + length - 5] ^= 1
    mcap.write_bytes(bytes(content))
    record = read_record(mcap)
    assert len(record["wire.voltage"]) == 175
    assert "wrong checksum" in findings(record)


def test_zeroed_pages_of_a_db3_cost_only_their_rows(temperature_bag):
    bag = temperature_bag(range(20, 5020), 10_000_000, "sqlite3")
    file = next(bag.glob("*.db3"))
    raw = bytearray(file.read_bytes())
    # Leaf pages of the message table begin with 0x0d and hold the topic's frame_id often.
    leaves = [
        at
        for at in range(0, len(raw), 4096)
        if raw[at] == 0x0D and raw.count(b"wire", at, at + 4096) > 20
    ]
    for at in (leaves[10], leaves[11], leaves[30]):
        raw[at : at + 4096] = bytes(4096)
    file.write_bytes(bytes(raw))
    record = read_record(bag)
    lost = 5000 - len(record["wire.temperature"])
    per_page = 5000 / len(leaves)
    assert 2 * per_page < lost < 4 * per_page
    assert "2 places of the message table cannot be read" in findings(record)
    assert f"{lost} of 5000 messages ({lost / 5000:.1%}) announced by" in findings(record)


def test_truncated_db3_is_read_up_to_the_cut(temperature_bag):
    bag = temperature_bag(range(20, 5020), 10_000_000, "sqlite3")
    file = next(bag.glob("*.db3"))
    raw = file.read_bytes()
    file.write_bytes(raw[: int(len(raw) * 0.6) // 4096 * 4096])
    record = read_record(bag)
    assert 1000 < len(record["wire.temperature"]) < 5000
    assert "damaged" in findings(record)


def test_db3_left_with_a_write_ahead_log_is_recovered_without_touching_it(tmp_path, db3):
    """Recorders that use sqlite's log leave the last messages in it when they die."""
    database = sqlite3.connect(db3)
    database.execute("PRAGMA journal_mode=WAL")
    rows = database.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
    database.execute("DELETE FROM messages WHERE id > 100")
    database.commit()
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
    database.executemany(insert, rows[100:])
    database.commit()
    died = tmp_path / "died"
    died.mkdir()
    for file in db3.parent.iterdir():
        shutil.copy(file, died / file.name)
    database.close()
    wal = died / (db3.name + "-wal")
    before = wal.read_bytes(), (died / db3.name).read_bytes()
    assert voltages(read_record(died)) == list(range(200))
    assert (wal.read_bytes(), (died / db3.name).read_bytes()) == before


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_truncated_zstd_file_is_read_up_to_the_cut(temperature_bag, storage):
    celsius = np.random.default_rng(0).normal(size=10_000)
    bag = temperature_bag(celsius, 1_000_000, storage, CompressionMode.FILE)
    file = next(bag.glob("*.zstd"))
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    record = read_record(bag)
    assert 1_000 < len(record["wire.temperature"]) < 10_000
    assert "the zstd compression is broken or cut short" in findings(record)


def test_broken_messages_of_a_message_compressed_bag_are_counted(tmp_path, write_bag, ramp):
    bag = write_bag(tmp_path / "bag", ramp, "sqlite3", CompressionMode.MESSAGE)
    database = sqlite3.connect(next(bag.glob("*.db3")))
    database.execute("UPDATE messages SET data = substr(data, 1, 20) WHERE id IN (5, 9)")
    database.commit()
    database.close()
    record = read_record(bag)
    assert len(record["wire.voltage"]) == 198
    assert "2 of 200 messages cannot be decoded and are left out" in findings(record)


def test_unreadable_metadata_does_not_hide_the_storage_file(mcap):
    for content in ("{", "rosbag2_bagfile_information: 3", "a: [", "\0\0", ""):
        (mcap.parent / "metadata.yaml").write_text(content)
        record = read_record(mcap.parent)
        assert len(record["wire.voltage"]) == 200
        assert "metadata.yaml: cannot be understood" in findings(record)


def test_folder_without_metadata_is_refused_naming_the_file_that_can_be_read(mcap):
    (mcap.parent / "metadata.yaml").unlink()
    with pytest.raises(InputError) as error:
        read_record(mcap.parent)
    assert "no metadata.yaml" in str(error.value)
    assert f"can be opened by itself: {mcap}" in str(error.value)
    assert len(read_record(mcap)["wire.voltage"]) == 200


def test_nothing_readable_is_one_line(tmp_path, write_bag, mcap):
    empty = write_bag(tmp_path / "empty", [], declare=[("/b/t", "std_msgs/msg/String")])
    folder = tmp_path / "folder"
    folder.mkdir()
    text_file = tmp_path / "notes.txt"
    text_file.write_text("no bag")
    zero = tmp_path / "zero.mcap"
    zero.write_bytes(b"")
    noise = tmp_path / "noise.db3"
    noise.write_bytes(random.Random(0).randbytes(5000))
    expected = {
        tmp_path / "absent": "no such file or folder",
        empty: "the bag holds no messages",
        folder: "the folder holds no metadata.yaml",
        text_file: "not a bag",
        zero: "the file is empty",
        noise: "nothing can be read",
    }
    for path, text in expected.items():
        with pytest.raises(InputError, match=text) as error:
            read_record(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_all_storage_files_missing_is_one_line(mcap):
    mcap.unlink()
    with pytest.raises(InputError, match=r"bag\.mcap: the storage file bag\.mcap is missing"):
        read_record(mcap.parent)


DAMAGES = {
    "flip": lambda rng, raw, at, n: raw[:at] + rng.randbytes(min(n, 8)) + raw[at + min(n, 8) :],
    "zero": lambda rng, raw, at, n: raw[:at] + bytes(min(n, len(raw) - at)) + raw[at + n :],
    "cut": lambda rng, raw, at, n: raw[:at],
    "insert": lambda rng, raw, at, n: raw[:at] + rng.randbytes(n) + raw[at:],
    "delete": lambda rng, raw, at, n: raw[:at] + raw[at + n :],
    "garbage": lambda rng, raw, at, n: raw[:at] + rng.randbytes(n) + raw[at + n :],
}


# ./bench check reliability does thousands.
_REPEATS = 20


@pytest.mark.parametrize("damage", sorted(DAMAGES))
def test_any_damage_ends_in_a_record_or_one_line(tmp_path, write_bag, ramp, damage):
    originals = [
        write_bag(tmp_path / f"{storage}_{mode.name}", ramp, storage, mode)
        for storage, mode in (
            ("mcap", CompressionMode.NONE),
            ("mcap", CompressionMode.STORAGE),
            ("mcap", CompressionMode.MESSAGE),
            ("sqlite3", CompressionMode.NONE),
            ("sqlite3", CompressionMode.FILE),
        )
    ]
    rng = random.Random(damage)
    for _ in range(_REPEATS):
        for original in originals:
            copy = tmp_path / "copy"
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(original, copy)
            storage = next(p for p in copy.iterdir() if p.name != "metadata.yaml")
            file = storage if rng.random() < 0.8 else copy / "metadata.yaml"
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


def test_the_row_before_a_damaged_page_is_read(tmp_path, write_bag, messages):
    """Python's cursor steps on before it gives out a row, and so lost the last good one."""
    content = []
    for k in range(3000):
        stamp = messages.start + k * 10_000_000
        content.append(("/b/wire/temperature", messages.temperature(stamp, 20 + k), stamp))
    bag = write_bag(tmp_path / "bag", content, "sqlite3")
    file = next(bag.glob("*.db3"))
    raw = bytearray(file.read_bytes())
    places = [raw.find(messages.serialise(message)) // 4096 for _, message, _ in content]
    page = places[1500] + 1
    raw[page * 4096 : (page + 1) * 4096] = bytes(4096)
    file.write_bytes(bytes(raw))
    found = set(np.rint(read_record(bag)["wire.temperature"].values - 293.15).astype(int).tolist())
    assert {k for k, place in enumerate(places) if place != page} == found


def test_a_table_that_leads_back_into_itself_ends(temperature_bag):
    """A damaged tree once gave its rows for ever, until the memory was full."""
    bag = temperature_bag(range(20, 3020), 10_000_000, "sqlite3")
    file = next(bag.glob("*.db3"))
    raw = bytearray(file.read_bytes())
    # The root of the message table: an interior page that names all the leaves.
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
    record = read_record(bag)
    assert 1000 < len(record["wire.temperature"]) < 3000
    assert "damaged" in findings(record)


@pytest.mark.parametrize("key", ["name", "message_count"])
def test_metadata_that_unfolds_to_gigabytes_is_passed_over(mcap, key):
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
    )
    topic = "{name: *a11}" if key == "name" else "{name: /b/t}"
    count = "*a11" if key == "message_count" else "1"
    (mcap.parent / "metadata.yaml").write_text(
        f"{bomb}rosbag2_bagfile_information:\n  relative_file_paths: [{mcap.name}]\n"
        f"  topics_with_message_count: [{{topic_metadata: {topic}, message_count: {count}}}]\n"
    )
    record = read_record(mcap.parent)
    assert len(record["wire.voltage"]) == 200
    assert "metadata.yaml: cannot be understood" in findings(record)

"""Reads the messages of an sqlite3 storage file, past damaged pages."""

import os
import shutil
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sma_bench.border import Budget
from sma_bench.records.harvest import Harvest, RawTopic, is_compiled
from sma_bench.records.record import IntArray

MAGIC = b"SQLite format 3\0"

_BATCH = 5000
_LAST_ROW = 2**62
_LARGEST_FILE = 2**38
_MOST_HOLES = 10_000
_SIDE_FILES = ("-wal", "-journal")
_TABLES = {"topics", "messages"}
_LARGEST_VALUE = 1 << 26
_LARGEST_STATEMENT = 1 << 20
_STEPS = 10_000  # of SQLite's machine, between two looks at the clock
# At the end of a journal: the next 16 bytes before it and a name say which file to delete with it.
_NAMES_ANOTHER = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"

_Row = tuple[int, int, int, bytes]
# A damaged schema can make sqlite3 fail to decode its own error message.
_READ_ERRORS = (sqlite3.Error, OverflowError, MemoryError, UnicodeError)


def scan_sqlite(path: Path, harvest: Harvest) -> None:
    """Add the messages of one sqlite3 file to the harvest.

    The file is opened as one that nobody changes. Of a writer that died in it a copy is recovered.

    Raises:
        OSError: the file cannot be opened.
        OverBudget: it asks for more than such a file may; what was found until then is there.
    """
    announced = _announced_size(path)
    missing = max(0, announced - path.stat().st_size) if announced <= _LARGEST_FILE else 0
    if missing:
        share = missing / announced
        text = f"cut short: {missing} of {announced} bytes ({share:.1%}) are missing"
        harvest.lost(path.name, text, bytes=missing)
    if missing or any(_size(path.with_name(path.name + suffix)) for suffix in _SIDE_FILES):
        _scan_copy(path, announced if missing else 0, harvest)
    else:
        uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        _scan(uri, path.name, path.stat().st_size, harvest)


def _announced_size(path: Path) -> int:
    """Size in bytes according to the file's header."""
    with path.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(MAGIC):
        return 0
    page_size, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
    return (65536 if page_size == 1 else page_size) * pages


def _scan_copy(path: Path, size: int, harvest: Harvest) -> None:
    """Scan a copy: sqlite recovers the last transactions of a writer that died in it, and accepts
    a file that is cut short once its missing pages are there, if only as zeros."""
    with TemporaryDirectory() as folder:
        copy = Path(folder, "copy.db3")
        shutil.copyfile(path, copy)
        if size:
            os.truncate(copy, size)
        for suffix in _SIDE_FILES:
            beside = path.with_name(path.name + suffix)
            if _size(beside):
                recovered = copy.with_name(copy.name + suffix)
                shutil.copyfile(beside, recovered)
                _forget_names(recovered)
        _scan(copy.as_uri(), path.name, copy.stat().st_size, harvest)


def _forget_names(journal: Path) -> None:
    """Leave no name at the end of a copied journal: SQLite would delete the file called so."""
    with journal.open("r+b") as file:
        end = file.seek(0, os.SEEK_END)
        while end >= len(_NAMES_ANOTHER):
            file.seek(end - len(_NAMES_ANOTHER))
            if file.read(len(_NAMES_ANOTHER)) != _NAMES_ANOTHER:
                return
            end = file.truncate(end - len(_NAMES_ANOTHER))


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() and not path.is_symlink() else 0


def _scan(uri: str, name: str, size: int, harvest: Harvest) -> None:
    budget = harvest.budget
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.text_factory = bytes
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_VALUE)
            database.setlimit(sqlite3.SQLITE_LIMIT_SQL_LENGTH, _LARGEST_STATEMENT)
            database.set_progress_handler(budget.is_over, _STEPS)
            database.execute("PRAGMA trusted_schema = OFF")
            _require_tables(database)
            topics = _topics(database, harvest)
            holes = _Holes()
            joined = is_compiled(size) and _is_plain_text(database)
            _take_messages(database, topics, holes, joined, budget)
            _count_others(database, topics, budget)
    except _READ_ERRORS as error:
        _unless_interrupted(error, budget)
        harvest.lost(name, f"damaged: {error}")
        return
    if holes.found:
        rows = f"about {holes.rows} rows" if holes.rows else "an unknown number of rows"
        text = f"damaged: {holes.found} places of the message table cannot be read, {rows} are lost"
        harvest.lost(name, text, places=holes.found, rows=holes.rows)


def _unless_interrupted(error: Exception, budget: Budget) -> None:
    """Raise what ended SQLite's work from outside: the time was over, or a signal came, whose
    exception does not get through SQLite."""
    if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
        budget.check()
        raise KeyboardInterrupt


def _require_tables(database: sqlite3.Connection) -> None:
    """DatabaseError unless topics and messages are tables with columns of their own: what a view
    says may be any program, one that never ends too."""
    kinds = {
        row[1].decode(errors="replace").lower(): row[2]
        for row in database.execute("PRAGMA main.table_list")
    }
    for name in sorted(_TABLES):
        if kinds.get(name) != b"table":
            raise sqlite3.DatabaseError(f"{name} is no table")
        columns = database.execute(f"PRAGMA main.table_xinfo({name})").fetchall()
        if any(column[6] for column in columns):
            raise sqlite3.DatabaseError(f"{name} has columns that are computed")


def _topics(database: sqlite3.Connection, harvest: Harvest) -> dict[int, RawTopic]:
    query = "SELECT id, name, type, serialization_format FROM topics"
    return {
        number: harvest.topic(*(text.decode(errors="replace") for text in texts))
        for number, *texts in database.execute(query)
        if isinstance(number, int) and all(isinstance(text, bytes) for text in texts)
    }


def _is_plain_text(database: sqlite3.Connection) -> bool:
    """Whether bytes can pass as text without being recoded."""
    return bool(database.execute("PRAGMA encoding").fetchone() == (b"UTF-8",))


def _take_messages(
    database: sqlite3.Connection, topics: dict[int, RawTopic], holes: "_Holes", joined: bool,
    budget: Budget,
) -> None:
    wanted = {number: topic for number, topic in topics.items() if topic.wanted}
    if not wanted:
        return
    for batch in _batches(database, tuple(wanted), holes, joined, budget):
        if isinstance(batch, list):
            _take_rows(batch, wanted)
        else:
            budget.take(len(batch.data))
            _take_joined(batch, wanted)


def _take_rows(rows: list[_Row], wanted: dict[int, RawTopic]) -> None:
    for _, number, time, data in rows:
        topic = wanted[number]
        topic.count += 1
        topic.times.append(time)
        topic.blobs.append(data)


def _take_joined(batch: "_Joined", wanted: dict[int, RawTopic]) -> None:
    raw = np.frombuffer(batch.data, dtype=np.uint8)
    stops = np.cumsum(batch.lengths)
    for number, topic in wanted.items():
        topic.add_found(number, raw, stops - batch.lengths, stops, batch.topics, batch.times)


def _count_others(
    database: sqlite3.Connection, topics: dict[int, RawTopic], budget: Budget
) -> None:
    others = [number for number, topic in topics.items() if not topic.wanted]
    if not others:
        return
    query = f"SELECT topic_id, COUNT(*) FROM messages WHERE {_in(others)} GROUP BY topic_id"
    try:
        for number, count in database.execute(query, others):
            topics[number].count += count
    except _READ_ERRORS as error:
        # Only a count of what nobody reads; the damage shows in the topics that are read.
        _unless_interrupted(error, budget)


class _Holes:
    """Stretches of the message table that cannot be read."""

    def __init__(self) -> None:
        self.found = 0
        self.rows = 0


def _in(numbers: Sequence[int]) -> str:
    return f"topic_id IN ({','.join('?' * len(numbers))})"


@dataclass
class _Joined:
    """Rows: `data` one after the other, and their topics, times [ns] and lengths, (n,) each."""

    data: bytes
    topics: IntArray
    times: IntArray
    lengths: IntArray


def _batches(
    database: sqlite3.Connection, numbers: tuple[int, ...], holes: _Holes, joined: bool,
    budget: Budget,
) -> Iterator[list[_Row] | _Joined]:
    """Rows in the order of rowid, a few thousand each time; row by row before damage."""
    query = _query(numbers)
    last, single = -1, False
    while holes.found < _MOST_HOLES:
        try:
            if single:
                one = query + " LIMIT 1"
                while rows := database.execute(one, (last + 1, *numbers)).fetchall():
                    last = _last_row(rows[-1][0], len(rows), last)
                    budget.take(len(rows[-1][3]))
                    yield rows
                return
            if joined:
                while found := _read_joined(database, numbers, last):
                    last, batch = found
                    yield batch
                return
            cursor = database.execute(query, (last + 1, *numbers))
            while rows := _some(cursor, budget):
                last = _last_row(rows[-1][0], len(rows), last)
                yield rows
            return
        except _READ_ERRORS as error:
            _unless_interrupted(error, budget)
            if not single:
                # Again, one row at a time, to get at those just before the damage. A query each:
                # Python's cursor steps to the next row before it gives out the present one.
                single = True
                continue
        budget.check()
        beyond = _beyond_hole(database, last + 1, numbers)
        holes.found += 1
        if beyond is None:
            holes.rows = 0 if holes.found == 1 else holes.rows
            return
        holes.rows += beyond - last - 1
        last, single = beyond - 1, False


def _some(cursor: sqlite3.Cursor, budget: Budget) -> list[_Row]:
    """The next few thousand rows; one after the other, for in a damaged tree a few bytes may be
    the data of them all."""
    rows = []
    for row in islice(cursor, _BATCH):
        budget.take(len(row[3]) + 1)
        rows.append(row)
    return rows


def _query(numbers: tuple[int, ...]) -> str:
    # Not `rowid > ?`: from the last row of a damaged page that would look into this page.
    return (
        "SELECT rowid, topic_id, timestamp, data FROM messages "
        f"WHERE rowid >= ? AND {_in(numbers)} AND typeof(data) = 'blob' "
        "AND typeof(timestamp) = 'integer' AND timestamp >= 0 ORDER BY rowid"
    )


def _read_joined(
    database: sqlite3.Connection, numbers: tuple[int, ...], last: int
) -> tuple[int, _Joined] | None:
    """The rows after `last`, put together by SQLite itself: a row of Python's costs far more.

    Raises:
        sqlite3.DatabaseError: they do not fit each other.
    """
    found = database.execute(
        "SELECT max(rowid), count(*), group_concat(CAST(data AS TEXT), ''), "
        "group_concat(timestamp), group_concat((topic_id << 32) + length(data)) FROM "
        f"(SELECT rowid, * FROM messages WHERE rowid >= ? AND {_in(numbers)} "
        f"AND typeof(data) = 'blob' ORDER BY rowid LIMIT {_BATCH})",
        (last + 1, *numbers),
    )
    highest, count, data, *texts = found.fetchone()
    if not count:
        return None
    try:
        times, packed = (np.fromstring(text, dtype=np.int64, sep=",") for text in texts)
    except (TypeError, ValueError):  # stamps that are no integers, or none at all
        raise sqlite3.DatabaseError("stamps are no integers") from None
    topics, lengths = packed >> 32, packed & 0xFFFFFFFF
    fit = len(times) == len(packed) == count and lengths.sum() == len(data)
    if not fit or times.min() < 0:
        raise sqlite3.DatabaseError("rows do not fit each other")
    return _last_row(highest, count, last), _Joined(data, topics, times, lengths)


def _last_row(last: object, count: int, before: int) -> int:
    """The last row number; sqlite3.DatabaseError where a damaged tree leads back, for ever."""
    if not isinstance(last, int) or last - before < count:
        raise sqlite3.DatabaseError("rows out of order")
    return last


def _beyond_hole(
    database: sqlite3.Connection, hole: int, numbers: tuple[int, ...]
) -> int | None:
    """A row number close after the damage, which begins at `hole`, from which rows can be read."""
    step = 1
    while not _readable(database, hole + step, numbers):
        step *= 2
        if hole + step > _LAST_ROW:
            return None
    low, high = step // 2, step
    while high - low > 1:
        middle = (low + high) // 2
        readable = _readable(database, hole + middle, numbers)
        low, high = (low, middle) if readable else (middle, high)
    return hole + high


def _readable(database: sqlite3.Connection, row: int, numbers: tuple[int, ...]) -> bool:
    try:
        found = database.execute(_query(numbers) + " LIMIT 1", (row, *numbers)).fetchone()
        return found is not None and found[0] >= row
    except _READ_ERRORS as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
            raise
        return False

# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Compiled: where messages lie in a buffer of an mcap file, and those of one topic out of a buffer
that holds those of all.
"""

from sma_bench.compiled import compiled


@compiled
def measure_topic(topic, starts, stops, topics):
    """How many messages are of one topic, and the bytes of their data.

    Args:
        topic: number of the topic.
        starts, stops: (n,) offsets of each message's data; topics: (n,) their topics' numbers.
    """
    count, size = 0, 0
    for k in range(starts.size):
        if topics[k] == topic:
            count += 1
            size += stops[k] - starts[k]
    return count, size


@compiled
def take_topic(buffer, topic, starts, stops, topics, times, taken, lengths, joined):
    """Copy the messages of one topic, as many as `measure_topic` counts.

    Args:
        buffer: (b,) uint8; starts, stops, topics: as for `measure_topic`; times: (n,) ns.
        taken, lengths, joined: the topic's times, lengths and data one after the other, written.
    """
    row, position = 0, 0
    for k in range(starts.size):
        if topics[k] != topic:
            continue
        size = stops[k] - starts[k]
        taken[row], lengths[row] = times[k], size
        source, target = buffer[starts[k] : stops[k]], joined[position : position + size]
        for j in range(size):
            target[j] = source[j]
        row += 1
        position += size


_MESSAGE = 0x05
_HEAD = 9  # opcode and length
_TIME_TOP = 22  # the time's highest byte
_LEAST = 22  # bytes of a message record: channel, sequence and two times; the data follow


@compiled
def number(buffer, position, size):
    """Unsigned little-endian number; compiled, one from 2^63 on comes out negative."""
    value = 0
    for k in range(size):
        value |= int(buffer[position + k]) << (8 * k)
    return value


@compiled
def find_messages(buffer, position, end, starts, stops, channels, times):
    """Message records from `position` on, up to the first record that is not a whole message.

    Args:
        buffer: (n,) uint8; position, end: offsets in it.
        starts, stops: (m,) of each message's data, written; channels, times: (m,) likewise. The
            search ends as well when they are full.

    Returns:
        How many were found, and where the next record begins.
    """
    count = 0
    while count < starts.size and position + _HEAD + _LEAST <= end:
        if buffer[position] != _MESSAGE:
            break
        length = number(buffer, position + 1, 8)
        time = number(buffer, position + 15, 8)
        beyond = buffer[position + _TIME_TOP] > 127  # no time is 2^63 ns or more
        if length < _LEAST or length > end - position - _HEAD or beyond:
            break
        starts[count] = position + _HEAD + _LEAST
        stops[count] = position + _HEAD + length
        channels[count] = number(buffer, position + _HEAD, 2)
        times[count] = time
        position += _HEAD + length
        count += 1
    return count, position

# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Compiled: where the messages of an mcap file lie that follow one another without a break."""

from sma_bench.compiled import compiled

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

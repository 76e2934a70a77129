# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Compiled: the messages of one topic out of a buffer that holds those of all."""

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

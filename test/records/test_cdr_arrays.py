"""Topics decoded as arrays say what rosbags says message by message."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.border import reading_budget
from sma_bench.records import cdr, contract

numbers = st.floats(width=32, allow_nan=False)
doubles = st.floats(allow_nan=False)
short_text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
headers = st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), short_text)


def decoded(blobs, kind):
    lengths = np.array([len(blob) for blob in blobs], dtype=np.int64)
    return cdr.decode(b"".join(blobs), lengths, kind, reading_budget(0))


@st.composite
def any_message(draw, messages):
    kind = draw(st.sampled_from(sorted(cdr.FIELDS)))
    ros = messages.ros
    if kind == contract.STRING:
        return ros(kind, data=draw(short_text))
    if kind == contract.MULTI_ARRAY:
        dims = [
            ros("std_msgs/msg/MultiArrayDimension", label=label, size=1, stride=2)
            for label in draw(st.lists(short_text, max_size=3))
        ]
        layout = ros("std_msgs/msg/MultiArrayLayout", dim=dims, data_offset=3)
        return ros(kind, layout=layout, data=np.array(draw(st.lists(doubles, max_size=5))))
    message = draw(stamped(messages, kind))
    seconds, nanoseconds, frame = draw(headers)
    message.header = messages.header(seconds * 10**9 + nanoseconds, frame)
    return message


def stamped(messages, kind):
    def joints(names, *columns):
        fields = zip(("position", "velocity", "effort"), map(np.array, columns), strict=True)
        return messages.ros(kind, header=None, name=names, **dict(fields))

    if kind == contract.JOINT_STATE:
        arrays = st.lists(doubles, max_size=3)
        return st.builds(joints, st.lists(short_text, max_size=3), arrays, arrays, arrays)
    builders = {
        contract.BATTERY_STATE: lambda a, b: messages.power(0, a, b),
        contract.TEMPERATURE: lambda a, b: messages.temperature(0, a),
        contract.RANGE: lambda a, b: messages.range(0, a, b),
    }
    return st.builds(builders[kind], numbers, numbers)


def value_of(message, field):
    field = field.replace("stamp.", "header.stamp.").replace("frame_id", "header.frame_id")
    for name in field.split("."):
        message = getattr(message, name)
    return message


def assert_decoded(blobs, originals, kind):
    seen = []
    for batch in decoded(blobs, kind):
        for at, row in enumerate(batch.rows.tolist()):
            seen.append(row)
            for field, column in batch.columns.items():
                wanted = np.ravel(value_of(originals[row], field)).astype(column.dtype)
                np.testing.assert_array_equal(column[at], wanted)
            if kind == contract.JOINT_STATE:
                assert list(batch.texts["name"]) == originals[row].name
            if kind == contract.STRING:
                assert batch.texts["data"] == (originals[row].data,)
    assert sorted(seen) == list(range(len(blobs)))


@settings(max_examples=80, deadline=None)
@given(data=st.data(), little_endian=st.booleans(), tail=st.integers(0, 8))
def test_any_mix_of_shapes_decodes_like_one_by_one(messages, data, little_endian, tail):
    kind = data.draw(st.sampled_from(sorted(cdr.FIELDS)))
    pool = data.draw(
        st.lists(any_message(messages).filter(lambda m: m.__msgtype__ == kind), max_size=4)
    )
    if not pool:
        return
    originals = data.draw(st.lists(st.sampled_from(pool), min_size=1, max_size=12))
    blobs = [
        bytes(messages.types.serialize_cdr(m, kind, little_endian=little_endian)) + b"\xa5" * tail
        for m in originals
    ]
    assert_decoded(blobs, originals, kind)


def test_more_layouts_of_one_length_than_are_tried_together(messages):
    names = [f"joint_{k:03}" for k in range(200)]
    originals = [messages.joints(5, [name], [float(k)]) for k, name in enumerate(names)]
    blobs = [messages.serialise(message) for message in originals]
    assert len({len(blob) for blob in blobs}) == 1
    assert_decoded(blobs, originals, contract.JOINT_STATE)


@settings(max_examples=300, deadline=None)
@given(
    blobs=st.lists(st.binary(max_size=80), max_size=6),
    kind=st.sampled_from(sorted(cdr.FIELDS)),
    prefix=st.sampled_from([b"", b"\0\0\0\0", b"\0\1\0\0"]),
)
def test_random_bytes_are_decoded_or_left_out(blobs, kind, prefix):
    blobs = [prefix + blob for blob in blobs]
    rows = [row for batch in decoded(blobs, kind) for row in batch.rows.tolist()]
    assert len(rows) == len(set(rows)) <= len(blobs)


def test_encoding_writes_what_decoding_reads_and_every_truncation_is_left_out(messages):
    template = messages.serialise(messages.joints(5, ["tip", "wire"], [1.0, 2.0], [3.0, 4.0]))
    cut = [template[:length] for length in range(len(template))]
    assert list(decoded(cut, contract.JOINT_STATE)) == []
    values = np.arange(6.0).reshape(3, 2)
    blobs = cdr.encode(template, contract.JOINT_STATE, {"effort": values})
    for blob, row in zip(blobs, values, strict=True):
        message = messages.types.deserialize_cdr(blob, contract.JOINT_STATE)
        assert message.effort.tolist() == row.tolist() and message.name == ["tip", "wire"]
    with pytest.raises(cdr.CdrError):
        cdr.encode(template, contract.JOINT_STATE, {"effort": np.zeros((3, 1))})

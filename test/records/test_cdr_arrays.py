"""Topics decoded as arrays: whatever the bytes, and back.

That they say what rosbags says message by message, test_read_bags shows on foreign and drawn bags.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.border import reading_budget
from sma_bench.records import cdr, contract


def decoded(blobs, kind):
    lengths = np.array([len(blob) for blob in blobs], dtype=np.int64)
    return list(cdr.decode(b"".join(blobs), lengths, kind, reading_budget(0)))


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
    assert decoded(cut, contract.JOINT_STATE) == []
    values = np.arange(6.0).reshape(3, 2)
    blobs = cdr.encode(template, contract.JOINT_STATE, {"effort": values})
    for blob, row in zip(blobs, values, strict=True):
        message = messages.types.deserialize_cdr(blob, contract.JOINT_STATE)
        assert message.effort.tolist() == row.tolist() and message.name == ["tip", "wire"]
    with pytest.raises(cdr.CdrError):
        cdr.encode(template, contract.JOINT_STATE, {"effort": np.zeros((3, 1))})

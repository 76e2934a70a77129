"""Voltages of several channels on one clock."""

from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.records import Record, Signal
from sma_bench.records.samples import held_voltages


def record(**volts):
    signals = {
        f"{name}.voltage": Signal(f"{name}.voltage", "V", np.array(t, float), np.array(v, float))
        for name, (t, v) in volts.items()
    }
    return Record(Path("bag"), 0, signals)


def test_each_channel_is_held_until_its_next_sample():
    time, voltage = held_voltages(
        record(a=([0.0, 2.0], [1.0, 2.0]), b=([1.0, 2.0], [5.0, 6.0])), ["b", "a"]
    )
    assert time.tolist() == [0.0, 1.0, 2.0]
    assert voltage.tolist() == [[5.0, 1.0], [5.0, 1.0], [6.0, 2.0]]


def test_a_channel_without_voltage_is_named():
    said = "no voltage of channel b.*bench of 2 channels .a, b., the record of one of 1 channel .a."
    with pytest.raises(InputError, match=said):
        held_voltages(record(a=([0.0], [1.0])), ["a", "b"])

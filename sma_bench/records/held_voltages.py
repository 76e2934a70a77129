"""The voltages that a bench applied, on one clock: what a simulation takes as its input."""

from collections.abc import Sequence

import numpy as np

from sma_bench.errors import InputError
from sma_bench.records.record import FloatArray, Record


def held_voltages(record: Record, channels: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Measured voltages of all channels, each held until its next sample.

    Args:
        record: with `<channel>.voltage` of every channel.
        channels: in the order of bench.channels.

    Returns:
        time (n,) s, the union of the channels' stamps, and voltage (n, w) V.

    Raises:
        InputError: the record lacks the voltage of a channel.
    """
    missing = [channel for channel in channels if f"{channel}.voltage" not in record.signals]
    if missing:
        found = ", ".join(record.channels) or "none"
        raise InputError(
            f"{record.path}: no voltage of channel {missing[0]} (bench.channels is "
            f"{', '.join(channels)}), found: {found}"
        )
    signals = [record[f"{channel}.voltage"] for channel in channels]
    time = np.unique(np.concatenate([signal.time for signal in signals]))
    held = [
        signal.values[np.maximum(np.searchsorted(signal.time, time, side="right") - 1, 0)]
        for signal in signals
    ]
    return time, np.stack(held, axis=1)

"""What is asked of the bench: voltages over time, read from YAML."""

from sma_bench.protocols.protocol import Protocol, Segment, Waiting
from sma_bench.protocols.reading import load_protocol, parse_protocol, protocol_names

__all__ = [
    "Protocol", "Segment", "Waiting", "load_protocol", "parse_protocol", "protocol_names",
]  # fmt: skip

"""Bags and instrument files in, named signals out; bag writing."""

from sma_bench.records.bag import read_record
from sma_bench.records.check import check_record
from sma_bench.records.instruments import DscRecord, DscSegment
from sma_bench.records.open import describe, open_record, open_records
from sma_bench.records.record import Record, Signal

# bag_writer is imported by its own name: it loads every message type of ROS.
__all__ = ["DscRecord", "DscSegment", "Record", "Signal", "check_record", "describe",
           "open_record", "open_records", "read_record"]

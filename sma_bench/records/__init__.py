"""Bags and instrument files in, named signals out; bag writing."""

from sma_bench.records.bag import read_record
from sma_bench.records.check import check_record, describe
from sma_bench.records.dsc import DscRecord, DscSegment, read_dsc
from sma_bench.records.open import open_record, open_records
from sma_bench.records.record import Record, Signal, Topic

# bag_writer and write are imported by their own names: they load every message type of ROS.
__all__ = [
    "DscRecord",
    "DscSegment",
    "Record",
    "Signal",
    "Topic",
    "check_record",
    "describe",
    "open_record",
    "open_records",
    "read_dsc",
    "read_record",
]

"""What a record holds, as plain data for people and programs."""

from datetime import UTC, datetime
from typing import Any

import numpy as np

from sma_bench.records.check import check_record
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.record import Signal
from sma_bench.records.tensile import TensileRecord


def describe(record: AnyRecord) -> dict[str, Any]:
    """Everything `sma-bench info` shows, as JSON-able data in SI units."""
    if isinstance(record, DscRecord):
        return _describe_dsc(record)
    if isinstance(record, IsobaricRecord):
        return _describe_isobaric(record)
    if isinstance(record, TensileRecord):
        return _describe_tensile(record)
    seconds = record.start_ns / 1e9
    return {
        "kind": "bag",
        "path": str(record.path),
        "start": datetime.fromtimestamp(seconds, UTC).isoformat(),
        "start_ns": record.start_ns,
        "duration": record.duration,
        "channels": list(record.channels),
        "topics": [
            {"name": name, "type": t.type, "count": t.count, "signals": list(t.signals)}
            for name, t in record.topics.items()
        ],
        "signals": [_describe_signal(signal) for signal in record.signals.values()],
        "markers": [{"time": time, "text": text} for time, text in record.markers],
        "findings": [finding.to_json() for finding in check_record(record)],
    }


def _describe_signal(signal: Signal) -> dict[str, Any]:
    steps = np.diff(signal.time)
    finite = signal.values[np.isfinite(signal.values)]
    period = signal.period
    received = signal.received
    delay = None if received is None else float(np.median(received - signal.time))
    return {
        "name": signal.name,
        "unit": signal.unit,
        "topic": signal.topic,
        "samples": len(signal),
        "rate": 1 / period if period > 0 else None,
        "jitter": float(np.subtract(*np.percentile(steps, [95, 5]))) if len(steps) else None,
        "longest_gap": float(steps.max()) if len(steps) else None,
        "delay": delay,
        "start": float(signal.time[0]) if len(signal) else None,
        "end": float(signal.time[-1]) if len(signal) else None,
        "min": float(finite.min()) if len(finite) else None,
        "max": float(finite.max()) if len(finite) else None,
        "mean": float(finite.mean()) if len(finite) else None,
    }


def _describe_dsc(record: DscRecord) -> dict[str, Any]:
    return {
        "kind": "dsc",
        "path": str(record.path),
        "instrument": record.instrument,
        "sample": record.sample,
        "mass": record.mass,
        "endothermic_up": record.endothermic_up,
        "segments": [
            {
                "number": segment.number,
                "kind": segment.kind,
                "rate": segment.rate,
                "samples": len(segment.time),
                "start": float(segment.time[0]),
                "end": float(segment.time[-1]),
                "from": float(segment.temperature[0]),
                "to": float(segment.temperature[-1]),
            }
            for segment in record.segments
        ],
        "findings": [finding.to_json() for finding in record.findings],
    }


def _describe_isobaric(record: IsobaricRecord) -> dict[str, Any]:
    branches = [(cycle, branch) for cycle in record.cycles for branch in cycle.branches]
    return {
        "kind": "isobaric",
        "path": str(record.path),
        "stress": record.stress,
        "strain_unit": record.strain_unit,
        "branches": [
            {
                "cycle": cycle.number,
                "kind": branch.direction,
                "samples": len(branch.temperature),
                "from": float(branch.temperature[0]),
                "to": float(branch.temperature[-1]),
                "strain_from": float(branch.strain[0]),
                "strain_to": float(branch.strain[-1]),
            }
            for cycle, branch in branches
        ],
        "findings": [finding.to_json() for finding in record.findings],
    }


def _describe_tensile(record: TensileRecord) -> dict[str, Any]:
    return {
        "kind": "tensile",
        "path": str(record.path),
        "temperature": record.temperature,
        "samples": len(record.strain),
        "largest_strain": float(record.strain.max()),
        "largest_stress": float(record.stress.max()),
        "findings": [finding.to_json() for finding in record.findings],
    }

"""Synthetic records that several sections measure with."""

from pathlib import Path

import numpy as np

import sma_bench
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import Record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import protocol_record

ROOT = Path(__file__).resolve().parents[2]
COMPOSITE = ROOT / "config" / "composite_rig.yaml"
RATE = 100.0  # Hz
TRIANGLES, STEPS = "composite_diagnosis_triangles", "composite_diagnosis_steps"
_HIDDEN = {"effect.side_heat_coupling.conductance": 0.03}
# 1 to 5.5 V and back, then 0.
_LEVELS = np.array([1.0, 1.9, 2.8, 3.7, 4.6, 5.5, 5.5, 4.6, 3.7, 2.8, 1.9, 1.0, 0.0])


def staircase_bag(bag: Path, duration: float) -> Path:
    """A wire led up and down a staircase of voltages, 5 s each."""
    time = np.arange(int(duration * RATE)) / RATE
    voltage = _LEVELS[(time / 5.0).astype(int) % _LEVELS.size]
    record = sma_bench.measure(sma_bench.simulate((time, voltage), Parameters.defaults()))
    write_record(bag, list(record.signals.values()))
    return bag


def diagnosis_case(folder: Path) -> tuple[Path, Path]:
    """A composite bag with an effect that its parameter file does not know."""
    paper = read_parameters(COMPOSITE)
    record = protocol_record(STEPS, paper.replace(_HIDDEN))
    bag, file = folder / "gap", folder / "paper.yaml"
    write_record(bag, list(record.signals.values()))
    write_parameters(file, paper)
    return bag, file


def long_record(protocol: str, length: float) -> Record:
    """A protocol of the composite again and again, in memory."""
    paper = read_parameters(COMPOSITE)
    once = load_protocol(protocol, paper).sample(1.0 / RATE)[1]
    time = np.arange(int(length * RATE)) / RATE
    voltage = np.take(once, np.arange(time.size), axis=0, mode="wrap")
    return sma_bench.measure(sma_bench.simulate((time, voltage), paper.replace(_HIDDEN)))

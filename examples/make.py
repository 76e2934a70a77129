"""Makes the tables of examples/ and prints what each is: ./bench python examples/make.py

All of them are synthetic: simulated by the package's own physics and written as instruments and
loggers would export them.
"""

import re
from pathlib import Path

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.synthetic import paper_specimens
from sma_bench.synthetic.bench_records import protocol_record, simulate_finely
from sma_bench.synthetic.paper_specimens import isobaric_test, tensile_test

HERE = Path(__file__).resolve().parent
TABLES = {
    "ten_tasks": {
        "run.csv": "quick_staircase on the paper's wire, its room warming by 0.02 K/s",
    },
    "your_own_actuator": {
        "run.csv": "the first stroke of a wire against a spring, without noise, every 0.5 s",
        "monday.csv": "a wire against a spring under triangles of duty, 5 um of noise",
        "tuesday.csv": "the same under steps",
        "wednesday.csv": "the same under sines squared",
    },
    "instruments": {
        "DSC.txt": "the paper's wire (Table II) in a calorimeter, two cycles at 5 K/min, every 4 s",
        "10_MPa.txt": "strain of the paper's wire over temperature at 10 MPa",
        "50_MPa.txt": "the same at 50 MPa",
        "100_MPa.txt": "the same at 100 MPa",
        "cold_1.csv": "tensile test of martensite at 293.15 K",
        "cold_2.csv": "the same, another specimen",
        "hot_1.csv": "tensile test of austenite at 403.15 K",
        "hot_2.csv": "the same, another specimen",
        "front_current.csv": "an ammeter that reads 1.02 times the current and 30 mA more",
    },
}
COLD, HOT = 293.15, 403.15  # K, Table III
_DSC_HEAD = """Sample ID:\tsynthetic NiTi wire
Sample Weight:\t{milligrams:.3f} mg
Total Points in Run:\t{points}
{steps}
"""
_DSC_COLUMNS = """\tTime\tUnsubtracted\tBaseline\tProgram\tSample\tApprox.
\t\tHeat Flow\tHeat Flow\tTemperature\tTemperature\tGas Flow
"""


def main() -> None:
    """Write every table. lab.yaml and rig.yaml are written by hand."""
    for folder, tables in TABLES.items():
        for name, what in tables.items():
            text = instrument_text(name, 8) if folder == "instruments" else logger_text(
                folder, Path(name).stem
            )
            (HERE / folder / name).write_text(text)
            print(f"{folder}/{name}: synthetic, {what}")


def instrument_text(name: str, every: int = 1) -> str:
    """The text of an instrument file; of DSC.txt only one reading in `every`."""
    if found := re.fullmatch(r"(\d+)_MPa\.txt", name):
        return _isobaric(float(found[1]))
    if found := re.fullmatch(r"(cold|hot)_(\d+)\.csv", name):
        return _tensile(found[1], int(found[2]))
    if name == "DSC.txt":
        return _dsc(every)
    return "reading,known\n" + "".join(
        f"{1.02 * amps + 0.03:.3f},{amps:.3f}\n" for amps in (0.0, 0.5, 1.0, 1.5, 2.0)
    )


def logger_text(folder: str, name: str) -> str:
    """A run of the bench of an example, as its data logger writes it."""
    if folder == "ten_tasks":
        return _warming_room()
    return _spring_run(name)


_SPRING_BENCH = Parameters({
    "bench.drive": "duty", "bench.supply_voltage": 12.0, "load.kind": "spring",
    "load.stiffness": 216.0, "load.preload": 6.1, "wire.length": 0.38, "wire.diameter": 0.25e-3,
    "wire.mass": 0.12e-3, "wire.surface_area": 298e-6, "wire.resistance": 6.95,
    "wire.heat_transfer_coefficient": 84.0, "wire.specific_heat": 515.0,
    "wire.austenite_start_temperature": 337.0, "wire.austenite_finish_temperature": 353.5,
    "wire.martensite_start_temperature": 334.5, "wire.martensite_finish_temperature": 323.0,
    "effect.latent_heat.heat": 7000.0,
})  # fmt: skip


def _spring_run(name: str) -> str:
    """Duty of a 12 V supply and position of a wire against a spring, as a data logger has them."""
    if name == "run":
        time, sigma = np.arange(0.0, 20.0, 0.5), 0.0
        duty = np.where((time >= 2.0) & (time < 10.0), 12.0, 0.0)  # %
    else:
        time, sigma = np.arange(0.0, 100.0, 0.05), 0.005  # s, mm
        inside = ((time - 3.0) % 32.0) / 32.0
        peak = 10.0 * np.choose((time // 32.0).astype(int), (1.0, 0.7, 0.85, 0.0))
        shape = {
            "monday": 2.0 * np.minimum(inside, 1.0 - inside), "tuesday": 1.0 * (inside < 0.5),
            "wednesday": np.sin(np.pi * inside) ** 2,
        }[name]  # fmt: skip
        duty = np.round(np.where(time > 3.0, peak * shape, 0.0), 2)
    run = simulate_finely(_SPRING_BENCH, time, 0.12 * duty)
    noise = sigma * np.random.default_rng(len(name)).standard_normal(len(time))
    position = 12.34 - 1e3 * run.deflection + noise  # mm
    rows = zip(1e3 * time, duty, position, strict=True)
    return "time [ms],duty [%],position [mm]\n" + "".join(
        f"{t:.0f},{d:.2f},{x:.3f}\n" for t, d, x in rows
    )


def _dsc(every: int) -> str:
    run = paper_specimens.dsc_run(Parameters.defaults())
    steps, blocks, points = [], [], 0
    for s in run.segments:
        low, high = (t - CELSIUS_ZERO for t in sorted(s.temperature[[0, -1]]))
        way = f"Heat from {low:.2f}" if s.kind == "heating" else f"Cool from {high:.2f}"
        end = high if s.kind == "heating" else low
        rate = abs(s.rate) * 60.0
        steps.append(f"{s.number})\t{way}C to {end:.2f}C at {rate:.2f}C/min\n")
        rows = np.column_stack([
            s.time / 60.0, 1e3 * s.heat_flow, 1e3 * s.baseline,
            s.program_temperature - CELSIUS_ZERO, s.temperature - CELSIUS_ZERO, 0.0 * s.time,
        ])  # fmt: skip
        lines = ["\t" + "\t".join(f"{value:.6f}" for value in row) for row in rows]
        lines = lines[::every]
        points += len(lines)
        blocks.append(f"{s.number}) DSC Temperature Scan\n{_DSC_COLUMNS}" + "\n".join(lines) + "\n")
    head = _DSC_HEAD.format(milligrams=1e6 * run.mass, points=points, steps="\n".join(steps))
    return head + "".join(blocks)


def _warming_room() -> str:
    """A staircase of a wire in a room that warms by 0.02 K/s, from a lab's own logger."""
    wire = paper_specimens.wire_rig(Parameters.defaults())
    effect = {"effect.ambient_drift.rate": 0.02}
    record = protocol_record("quick_staircase", wire.replace(effect), 1)
    time = record["wire.temperature"].time[::4]
    volts, amps, kelvin = (
        record[f"wire.{name}"].values[np.searchsorted(record[f"wire.{name}"].time, time)]
        for name in ("voltage", "current", "temperature")
    )
    rows = zip(time, volts, amps, kelvin - CELSIUS_ZERO, strict=True)
    return "time [s],voltage [V],current [A],temperature [degC]\n" + "".join(
        f"{t:.3f},{v:.3f},{i:.4f},{c:.2f}\n" for t, v, i, c in rows
    )


def _isobaric(megapascal: float) -> str:
    wire = paper_specimens.wire_rig(Parameters.defaults())
    test = isobaric_test(wire, 1e6 * megapascal, "made", seed=int(megapascal))
    branches = [branch for cycle in test.cycles for branch in cycle.branches]
    return "".join(
        f"{t - CELSIUS_ZERO:.3f}\t{e:.6f}\t{1e-6 * s:.3f}\n"
        for b in branches
        for t, e, s in zip(b.temperature, b.strain, b.stress, strict=True)
    )


def _tensile(phase: str, number: int) -> str:
    kelvin = COLD if phase == "cold" else HOT
    test = tensile_test(Parameters.defaults(), kelvin, "made", seed=number)
    rows = zip(test.strain[::3], test.stress[::3], strict=True)
    head = f"Temperature: {kelvin:.2f} K\nPhase: {test.phase}\nStrain (mm/mm),Stress (MPa)\n"
    return head + "".join(f"{strain:.6f},{1e-6 * stress:.3f}\n" for strain, stress in rows)


if __name__ == "__main__":
    main()

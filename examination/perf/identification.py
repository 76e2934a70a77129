"""Identification of a whole bench (E10) over the record's length."""

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

from examination.perf.measuring import LINEAR, Figure, exponent, processor
from examination.perf.records import COMPOSITE, TRIANGLES, long_record
from sma_bench.identify import identify
from sma_bench.parameters import read_parameters

LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0, "an hour": 3600.0}
LONGEST = 28_800.0  # s


def measure(tiny: bool = False) -> Iterator[Figure]:
    """Each length in a process of its own, whose memory is then its own."""
    seconds, megabytes = [], []
    for name, length in {"a minute": 60.0}.items() if tiny else LENGTHS.items():
        _, cpu, memory = apart(__file__, TRIANGLES, length)
        yield Figure(f"E10: {name} at 100 Hz", "identification: processor", cpu, "s")
        yield Figure(f"E10: {name} at 100 Hz", "largest memory", memory, "MB")
        seconds.append(cpu)
        megabytes.append(memory)
    if tiny:
        return
    case, span, sizes = "E10 over the length", "from 10 minutes to an hour", (600.0, 3600.0)
    slope, growth = exponent(sizes, seconds[1:]), exponent(sizes, megabytes[1:])
    yield Figure(case, f"processor: exponent {span}", slope, most=LINEAR)
    yield Figure(case, f"memory: exponent {span}", growth, most=LINEAR)
    needed = megabytes[-1] * (LONGEST / sizes[-1]) ** growth
    yield Figure("E10: 8 hours at 100 Hz", "largest memory (extrapolated)", needed, "MB")


def apart(script: str, protocol: str, length: float) -> tuple[float, float, float]:
    """What `spent` says in a process that works on a record of this length."""
    command = [sys.executable, script, protocol, str(length)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    wall, cpu, memory = map(float, said.split())
    return wall, cpu, memory


def spent(work: Callable[[], object]) -> tuple[float, float, float]:
    """Seconds on the wall and of the processor; the most memory of this process, MB."""
    begin, before = time.perf_counter(), processor()
    work()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return time.perf_counter() - begin, processor() - before, memory


if __name__ == "__main__":
    record_ = long_record(sys.argv[1], float(sys.argv[2]))
    print(*spent(lambda: identify([record_], read_parameters(COMPOSITE), experiments=["E10"])))

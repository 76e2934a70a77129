"""A bench without hardware: the real image on an emulated Uno, with wires, behind a port.

    python test/firmware/emulated_bench.py [PARAMETERS.yaml]

prints the port for a host to open, and runs in real time until it is interrupted.
"""

import contextlib
import sys
import tempfile
import threading
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from emulated_uno import EmulatedUno, build_emulator, build_firmware
from plant import Plant
from pty_bench import on_a_port

from sma_bench.parameters import Parameters, read_parameters


def main(arguments: list[str]) -> None:
    """Run until interrupted."""
    parameters = read_parameters(Path(arguments[0])) if arguments else Parameters.defaults()
    with tempfile.TemporaryDirectory() as folder:
        uno = EmulatedUno(build_emulator(Path(folder)), build_firmware(Path(folder)))
        plant = Plant(uno, parameters)
        plant.run(0.01)  # compiles the physics before time begins
        with on_a_port(uno, plant.advance) as bench, contextlib.suppress(KeyboardInterrupt):
            print(bench.path, flush=True)
            threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1:])

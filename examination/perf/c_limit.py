"""The limit of the simulation: recurrence.c, compiled at run time, called through ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at
from sma_bench.physics.kernel import Kernel

SOURCE = Path(__file__).with_name("recurrence.c")
FLAGS = ("-O3", "-march=native", "-std=c11", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")

# struct model, in its order.
_MODEL = (
    at.AMBIENT, at.HEATING, at.TIME_CONSTANT, at.LATENT_RISE,
    at.AUSTENITE_FINISH, at.AUSTENITE_SLOPE, at.AUSTENITE_SHIFT,
    at.MARTENSITE_FINISH, at.MARTENSITE_SLOPE, at.MARTENSITE_SHIFT,
    at.AUSTENITE_MODULUS, at.MODULUS_CHANGE, at.RECOVERABLE_STRAIN, at.EXPANSION,
    at.HEATED_OTHERWISE, at.CAPACITY, at.LOSS, at.RESISTANCE,
    at.AUSTENITE_RESISTANCE, at.RESISTANCE_SLOPE, at.CONVECTION_RISE,
)


class NoCompiler(Exception):
    """There is no C compiler, or it cannot compile the limit."""


@cache
def _library() -> ctypes.CDLL:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise NoCompiler("no C compiler (cc): the limit is not measured")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "recurrence.so")
        command = [compiler, *FLAGS, str(SOURCE), "-o", str(library), "-lm"]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        if process.returncode:
            last = process.stderr.strip().splitlines()[-1:]
            raise NoCompiler(f"{compiler} does not compile the limit: {' '.join(last)}")
        return ctypes.CDLL(str(library))


class PlainC:
    """recurrence.c with the numbers of a bench; runs without Python's lock."""

    def __init__(self, parameters: Parameters) -> None:
        """Raises NoCompiler."""
        self._call = _library().recurrence
        self._call.restype = None
        wires, sides = Kernel(parameters, None).rows
        self._model = np.ascontiguousarray(wires[0, list(_MODEL)])
        self._side = wires[:, at.SIDE].astype(np.int32)
        stiffness = np.where(sides[:, at.PRESCRIBED] > 0.0, -1.0, sides[:, at.STIFFNESS])
        self._stiffness = np.ascontiguousarray(stiffness)

    def __call__(self, time: np.ndarray, voltage: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """history (3, n, w): temperature, fraction, stress; strain (n, s). From rest."""
        n, w = voltage.shape
        s = len(self._stiffness)
        history, strain = np.empty((3, n, w)), np.empty((n, s))
        arrays = (self._side, self._stiffness, time, voltage, history, strain)
        self._call(
            _pointer(self._model), ctypes.c_long(n), w, s, *(_pointer(array) for array in arrays)
        )
        return history, strain


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)

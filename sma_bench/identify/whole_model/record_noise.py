"""Noise of one record: of every sensor, coloured, and what errors of the inputs do to all of them.

With whitened residuals r of all signals, D the whitened effects of K possible errors of the
measured voltages and L those of one standard error of each held load,
cov(r) = I + s^2 D D'/K + L L'; rows are multiplied by its inverse root, so that a fit neither
trusts its inputs blindly nor has to carry their errors as unknowns. The size s is the most likely
one, but at least 1, which is what the noise and the steps of the voltages' converter make.
"""

from collections.abc import Sequence

import numpy as np

from sma_bench.identify.colour import WHITE, Colour, estimate_colour, white_noise_level
from sma_bench.identify.estimate import Array
from sma_bench.identify.noise import resolution
from sma_bench.identify.whole_model.rig_record import Measured, RigRecord

_SMALLEST_MODE = 1e-6
# A fit absorbs much of what the voltages' errors do: a small rest does not make them small.
_SIZES = (1.0, 5.0)
_ROUNDS = 2


class RecordNoise:
    """Weights of one record's rows; columns come as one array a signal, (m_i,) or (m_i, k).

    Attributes:
        floor: white noise level of each signal in its unit.
        colour: of each signal's noise in units of `floor`.
        size: of the voltages' errors, relative to what was supposed.
    """

    def __init__(self, rig: RigRecord) -> None:
        """White noise of the level that each signal shows from sample to sample."""
        self._rig = rig
        self.floor = [noise_floor(m.values) for m in rig.measured]
        self.colour: list[Colour] = [WHITE for _ in rig.measured]
        self.size = 1.0
        self._drawn = 0
        self._moves: list[Array] = []
        self._whiten_moves()

    def whiten(self, signal: int, columns: Array) -> Array:
        """Columns of one signal, scaled and whitened, all of its rows."""
        return self.colour[signal].whiten(columns / self.floor[signal])

    def rows(self, columns: Sequence[Array]) -> Array:
        """Everything the columns of all signals say, as rows of unit variance."""
        stacked = self._stack(columns)
        if not self._moves:
            return stacked
        seen = self._modes.T @ stacked
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + self._power)
        shrink = shrink if seen.ndim == 1 else shrink[:, np.newaxis]
        return np.asarray(stacked - self._modes @ (shrink * seen))

    def set_input_errors(
        self, drawn: Sequence[Sequence[Array]], exact: Sequence[Sequence[Array]]
    ) -> None:
        """Effects on every signal of equally likely errors of the voltages, and of one standard
        error of each held load."""
        self._drawn = len(drawn)
        every = [*drawn, *exact]
        self._moves = [np.column_stack(signal) for signal in zip(*every, strict=True)]
        self._whiten_moves()

    def estimate(self, residual: Sequence[Array]) -> None:
        """Take the colour of each signal's noise, and the size of the voltages' errors, from what
        a fit leaves."""
        for _ in range(_ROUNDS):
            left = self.explained_by_input(residual)
            self.colour = [
                estimate_colour((r - e) / floor)
                for r, e, floor in zip(residual, left, self.floor, strict=True)
            ]
            self._whiten_moves()
            self._estimate_size(residual)

    def explained_by_input(self, residual: Sequence[Array]) -> list[Array]:
        """The part of each residual that errors of the inputs most likely made."""
        if not self._moves:
            return [np.zeros_like(r) for r in residual]
        seen = self._effects.T @ self._stack(residual)
        scale = self._scales(self.size)
        likely = scale * np.linalg.solve(self._information(self.size), scale * seen)
        return [moves @ likely for moves in self._moves]

    def _scales(self, size: float) -> Array:
        """(K + L,) factors of the effects."""
        scale = np.ones(self._effects.shape[1])
        scale[: self._drawn] = size / np.sqrt(max(self._drawn, 1))
        return scale

    def _information(self, size: float) -> Array:
        scale = self._scales(size)
        return np.eye(len(scale)) + scale[:, np.newaxis] * self._gram * scale

    def _estimate_size(self, residual: Sequence[Array]) -> None:
        if not self._drawn:
            return
        seen = self._effects.T @ self._stack(residual)

        def surprise(log_size: float) -> float:
            information = self._information(float(np.exp(log_size)))
            target = self._scales(float(np.exp(log_size))) * seen
            explained = float(target @ np.linalg.solve(information, target))
            return float(np.linalg.slogdet(information)[1]) - explained

        from scipy.optimize import minimize_scalar  # half a second to load

        found = minimize_scalar(surprise, bounds=np.log(_SIZES), method="bounded")
        self.size = float(np.exp(found.x))
        self._find_modes()

    def _stack(self, columns: Sequence[Array]) -> Array:
        blocks = []
        for signal, column in enumerate(columns):
            white = self.whiten(signal, column)
            basis = self._bases[signal]
            blocks.append(white if basis is None else basis.T @ white)
        return np.concatenate(blocks)

    def _whiten_moves(self) -> None:
        self._bases = [self._basis(k, m) for k, m in enumerate(self._rig.measured)]
        if self._moves:
            self._effects = self._stack(self._moves)
            self._gram = self._effects.T @ self._effects
            self._find_modes()

    def _find_modes(self) -> None:
        scale = self._scales(self.size)
        power, directions = np.linalg.eigh(scale[:, np.newaxis] * self._gram * scale)
        keep = power > _SMALLEST_MODE
        self._power = power[keep]
        turn = scale[:, np.newaxis] * directions[:, keep] / np.sqrt(self._power)
        self._modes = self._effects @ turn

    def _basis(self, signal: int, measured: Measured) -> Array | None:
        """A current is a line, V/R and a zero: two rows hold all that it says of them."""
        if measured.quantity != "current":
            return None
        volts = self._rig.voltage.at(measured.wire, measured.time)
        line = np.column_stack([volts, np.ones(len(volts))])
        return np.asarray(np.linalg.qr(self.whiten(signal, line))[0])


def noise_floor(values: Array) -> float:
    """White noise of one sample among its neighbours (n,), its converter's included; never 0."""
    floor = max(white_noise_level(values), resolution(values) / np.sqrt(12.0))
    return float(floor) or 1e-6 * max(float(np.ptp(values)), 1e-12)

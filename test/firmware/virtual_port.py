"""A serial port in virtual time: the real link runs on it as fast as the machine can."""

from uno.emulated_uno import EmulatedUno

USB_FRAME = 1e-3


class VirtualPort:
    """Waiting for bytes is what lets the emulated Uno's time pass, a USB frame at a time."""

    def __init__(self, uno: EmulatedUno, drift: float = 0.0) -> None:
        """`drift`: how much faster the host's clock goes than the Uno's."""
        self._uno = uno
        self._rate = 1.0 + drift
        self._pending = b""
        self.timeout: float | None = USB_FRAME

    def clock(self) -> float:
        """The host's clock in s."""
        return self._uno.time * self._rate

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._pending)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; what one frame brings."""
        if not self._pending:
            self._uno.run(USB_FRAME / self._rate)
            self._pending = self._uno.read()
        read, self._pending = self._pending[:size], self._pending[size:]
        return read

    def write(self, data: bytes) -> int:
        """Bytes to the board."""
        self._uno.write(data)
        return len(data)

    def close(self) -> None:
        """Nothing to give back."""

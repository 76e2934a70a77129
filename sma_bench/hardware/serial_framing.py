"""Bytes of the serial protocol: checksums, lines, frames (docs/serial_protocol.md)."""

import binascii

LINE_END = b"\n"
FRAME_END = b"\0"
_CHECKSUM_BYTES = 2
_CHECKSUM_DIGITS = 4
# Far above any message: what is longer has lost its end.
_LONGEST = 512


def checksum(body: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(body, 0xFFFF)


def line(body: str) -> bytes:
    """A command or message as a line, ready to send."""
    encoded = body.encode("ascii")
    return encoded + b"*%04X" % checksum(encoded) + LINE_END


def frame(body: bytes) -> bytes:
    """A message as a binary frame, its delimiter included."""
    sealed = body + checksum(body).to_bytes(_CHECKSUM_BYTES, "little")
    stuffed = b"".join(
        _block(block, last)
        for piece in sealed.split(FRAME_END)
        for block, last in _blocks(piece)
    )
    return stuffed + FRAME_END


def _blocks(piece: bytes) -> list[tuple[bytes, bool]]:
    starts = range(0, max(len(piece), 1), 254)
    return [(piece[at : at + 254], at + 254 >= len(piece)) for at in starts]


def _block(block: bytes, last: bool) -> bytes:
    return bytes([len(block) + 1 if last else 255]) + block


def open_line(text: bytes) -> bytes | None:
    """The body of a line without its end; None when the checksum is absent or wrong."""
    text = text.removesuffix(b"\r")
    body, star, digits = text[:-5], text[-5:-4], text[-4:]
    if star != b"*" or digits != b"%04X" % checksum(body):
        return None
    return body


def open_frame(stuffed: bytes) -> bytes | None:
    """The body of a frame without its delimiter; None when it is damaged."""
    sealed = bytearray()
    at = 0
    while at < len(stuffed):
        code = stuffed[at]
        if code == 0 or at + code > len(stuffed):
            return None
        sealed += stuffed[at + 1 : at + code]
        at += code
        if code < 255 and at < len(stuffed):
            sealed.append(0)
    body, crc = bytes(sealed[:-_CHECKSUM_BYTES]), sealed[-_CHECKSUM_BYTES:]
    if not body or int.from_bytes(crc, "little") != checksum(body):
        return None
    return body


class Splitter:
    """Cuts a stream of bytes into the bodies of messages."""

    def __init__(self) -> None:
        self._pending = b""
        self._binary = False
        self._in_step = False
        self.damaged = 0

    @property
    def binary(self) -> bool:
        """True when frames are expected, not lines."""
        return self._binary

    def expect(self, binary: bool) -> None:
        """Forget what is pending and expect frames (`binary`) or lines from here on."""
        self._pending = b""
        self._binary = binary
        self._in_step = False

    def feed(self, received: bytes) -> list[bytes]:
        """Bodies of the messages that `received` completes; damaged ones are counted."""
        end = FRAME_END if self._binary else LINE_END
        *complete, self._pending = (self._pending + received).split(end)
        if len(self._pending) > _LONGEST:
            self.damaged += 1
            self._pending = b""
        return [body for piece in complete if (body := self._open(piece)) is not None]

    def _open(self, piece: bytes) -> bytes | None:
        if not piece.strip():
            return None
        body = open_frame(piece) if self._binary else open_line(piece)
        # The first piece may have begun before this host listened.
        self.damaged += body is None and self._in_step
        self._in_step = True
        return body

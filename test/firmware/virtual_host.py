"""A host, and a serial port, in virtual time: no threads, no waiting, every run the same."""

from sma_bench.hardware.serial_messages import (
    Accepted,
    Named,
    Refused,
    Splitter,
    Telemetry,
    command,
    decode,
    line,
)

SLICE = 1e-3


class VirtualHost:
    """Speaks the protocol with an emulated Uno."""

    def __init__(self, uno):
        self.uno = uno
        self.messages = []
        self.splitter = Splitter()
        self.session = 0
        self._sequence = 0

    def run(self, seconds):
        """Let time pass; the messages that came meanwhile."""
        self.uno.run(seconds)
        messages = [decode(body) for body in self.splitter.feed(self.uno.read())]
        self.messages += messages
        return messages

    def say(self, letter, *numbers):
        """A command, and what came within 20 ms of it."""
        self.uno.write(line(command(letter, *numbers)))
        return self.run(0.02)

    def consent(self, letter, *numbers):
        """The value with which a command was accepted."""
        answers = [m for m in self.say(letter, *numbers) if isinstance(m, Accepted | Refused)]
        assert isinstance(answers[-1], Accepted), str(answers[-1])
        return answers[-1].value

    def refusal(self, letter, *numbers):
        """The reason for which a command was refused."""
        return next(m.reason for m in self.say(letter, *numbers) if isinstance(m, Refused))

    def named(self, letter, kind):
        """The `key=value` line of a kind that answers a command."""
        answers = self.say(letter)
        return next(m.values for m in answers if isinstance(m, Named) and m.letter == kind)

    def arm(self, limits=()):
        """Handshake, limits of the rig, and arming."""
        if limits:
            self.consent("C", *limits)
        self.session = self.consent("A", int(self.named("?", "H")["nonce"]))
        self._sequence = 0

    def command_line(self, *millivolts):
        """The next voltage command."""
        self._sequence += 1
        return line(command("V", self.session, self._sequence, *millivolts))

    def drive(self, *millivolts):
        """Send a voltage command; no time passes."""
        self.uno.write(self.command_line(*millivolts))

    def hold(self, seconds, *millivolts):
        """Command the same volts every 50 ms."""
        for _ in range(round(seconds / 0.05)):
            self.drive(*millivolts)
            self.run(0.05)

    def time_until_off(self, limit, step=SLICE):
        """Seconds from now until no output was high for a whole PWM period (1.024 ms).

        The answer is the time of the last high output, at a resolution of `step`.
        """
        start = last_on = self.uno.time
        while self.uno.time - start < limit:
            before = sum(self.uno.electrics.on_time)
            self.run(step)
            if sum(self.uno.electrics.on_time) > before:
                last_on = self.uno.time
        return last_on - start

    def outputs_stay_off(self, seconds):
        """True when no output goes high during the next `seconds`."""
        before = sum(self.uno.electrics.on_time)
        self.run(seconds)
        return sum(self.uno.electrics.on_time) == before

    @property
    def telemetry(self):
        """All frames so far."""
        return [m for m in self.messages if isinstance(m, Telemetry)]


USB_FRAME = 1e-3


class VirtualPort:
    """Waiting for bytes is what lets the emulated Uno's time pass, a USB frame at a time."""

    def __init__(self, uno, drift=0.0):
        """`drift`: how much faster the host's clock goes than the Uno's."""
        self._uno = uno
        self._rate = 1.0 + drift
        self._pending = b""
        self.timeout = USB_FRAME

    def clock(self):
        """The host's clock in s."""
        return self._uno.time * self._rate

    @property
    def in_waiting(self):
        """Bytes that can be read at once."""
        return len(self._pending)

    def read(self, size=1):
        """Up to `size` bytes; what one frame brings."""
        if not self._pending:
            self._uno.run(USB_FRAME / self._rate)
            self._pending = self._uno.read()
        read, self._pending = self._pending[:size], self._pending[size:]
        return read

    def write(self, data):
        """Bytes to the board."""
        self._uno.write(data)
        return len(data)

    def close(self):
        """Nothing to give back."""

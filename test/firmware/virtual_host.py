"""A host and a serial port in virtual time: without threads or waiting, reproducible."""

from sma_bench.hardware import serial_messages
from sma_bench.hardware.serial_messages import Accepted, Named, Refused, Telemetry, command, line

SLICE = USB_FRAME = 1e-3


class VirtualHost:
    """Speaks the protocol with an emulated Uno."""

    def __init__(self, uno):
        self.uno = uno
        self.messages = []
        self.splitter = serial_messages.Splitter()
        self.session = self._sequence = 0

    def run(self, seconds):
        self.uno.run(seconds)
        bodies = self.splitter.feed(self.uno.read())
        messages = [serial_messages.decode(body) for body in bodies]
        self.messages += messages
        return messages

    def say(self, letter, *numbers):
        self.uno.write(line(command(letter, *numbers)))
        return [m for m in self.run(0.02) if not isinstance(m, Telemetry)]

    def consent(self, letter, *numbers):
        answers = [m for m in self.say(letter, *numbers) if isinstance(m, Accepted | Refused)]
        assert isinstance(answers[-1], Accepted), str(answers[-1])
        return answers[-1].value

    def refusal(self, letter, *numbers):
        (answer,) = self.say(letter, *numbers)
        assert isinstance(answer, Refused), answer
        return answer.reason

    def named(self, letter, kind):
        answers = self.say(letter)
        return next(m.values for m in answers if isinstance(m, Named) and m.letter == kind)

    def arm(self, limits=()):
        if limits:
            self.consent("C", *limits)
        self.session = self.consent("A", int(self.named("?", "H")["nonce"]))
        self._sequence = 0

    def command_line(self, *millivolts):
        self._sequence += 1
        return line(command("V", self.session, self._sequence, *millivolts))

    def drive(self, *millivolts):
        self.uno.write(self.command_line(*millivolts))

    def hold(self, seconds, *millivolts):
        for _ in range(round(seconds / 0.05)):
            self.drive(*millivolts)
            self.run(0.05)

    def time_until_off(self, limit):
        """Time (s, to 1 ms) of the last moment within `limit` s at which an output is high."""
        start = last_on = self.uno.time
        while self.uno.time - start < limit:
            if not self.outputs_stay_off(SLICE):
                last_on = self.uno.time
        return last_on - start

    def outputs_stay_off(self, seconds):
        before = sum(self.uno.electrics.on_time)
        self.run(seconds)
        return sum(self.uno.electrics.on_time) == before

    @property
    def telemetry(self):
        return [m for m in self.messages if isinstance(m, Telemetry)]


class VirtualPort:
    """While it waits for bytes the emulated Uno's time passes, one USB frame at a time."""

    def __init__(self, uno, drift=0.0):
        self._uno, self._rate = uno, 1.0 + drift
        self._pending = b""
        self.timeout = USB_FRAME

    def clock(self):
        return self._uno.time * self._rate

    @property
    def in_waiting(self):
        return len(self._pending)

    def read(self, size=1):
        if not self._pending:
            self._uno.run(USB_FRAME / self._rate)
            self._pending = self._uno.read()
        read, self._pending = self._pending[:size], self._pending[size:]
        return read

    def write(self, data):
        self._uno.write(data)
        return len(data)

    def close(self):
        pass

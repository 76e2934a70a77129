"""docs/hardware.md and its drawing say the pins and limits that the firmware has."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "hardware.md").read_text()
DRAWING = (ROOT / "docs" / "hardware.svg").read_text()
ANALOG = {
    "FRONT_CURRENT": "front current", "BACK_CURRENT": "back current", "SUPPLY": "supply",
    "FRONT_RANGE": "front range", "BACK_RANGE": "back range",
}
# Arduino's names of the port pins that an Uno brings out.
DIGITAL = {"PD6": "D6", "PD5": "D5", "PB3": "D11", "PD3": "D3", "PD4": "D4"}


def firmware(name: str) -> str:
    return (ROOT / "firmware" / name).read_text()


def documented_pins() -> dict[str, str]:
    return dict(re.findall(r"^\| ([AD]\d+) \| ([\w ]+?) \|", PAGE, re.MULTILINE))


def coded_pins() -> dict[str, str]:
    """From the comments at the output masks, whose pins the emulated runs prove, and the inputs."""
    pins = {}
    for mask, comment in re.findall(r"#define \w+_PINS (.+?)/\* (.+?) \*/", firmware("pwm.c")):
        ports = re.findall(r"_BV\((P\w\d)\)", mask)
        pins |= {DIGITAL[p]: c for p, c in zip(ports, comment.split(", "), strict=True)}
    inputs = re.findall(r"\[([A-Z_]+)\] = (\d)", firmware("sampling.c"))
    return pins | {f"A{number}": ANALOG[name] for name, number in inputs}


def test_pins_are_those_of_the_firmware() -> None:
    assert len(coded_pins()) == 10
    assert documented_pins() == coded_pins()


def test_outputs_are_those_of_the_emulated_pins() -> None:
    source = (ROOT / "test" / "tools" / "uno" / "uno.c").read_text()
    found = re.findall(r"\{'(\w)', (\d), 0x", source)
    names = [DIGITAL[f"P{port}{pin}"] for port, pin in found]
    order = re.search(r"#define CHANNELS 4 +/\* (.+?) \*/", firmware("config.h"))
    assert order is not None
    assert [coded_pins()[name] for name in names] == order[1].split(", ")


@pytest.mark.parametrize("pin", sorted(coded_pins()))
def test_the_drawing_has_the_pin(pin: str) -> None:
    assert f">{pin} {coded_pins()[pin]}<" in DRAWING


def test_limits_are_those_of_the_firmware() -> None:
    coded = dict(re.findall(r"#define (\w+) (\d+)", firmware("config.h")))
    documented = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", PAGE, re.MULTILINE))
    assert len(documented) == 14
    assert {name: coded[name] for name in documented} == documented

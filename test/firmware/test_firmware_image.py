"""The firmware: its logic on this computer, its image and budgets, the pins that the pages say."""

import re
import subprocess
from pathlib import Path

import pytest
from host_firmware import build_program, run_program

from examination.check import fuzz

HERE = Path(__file__).resolve().parent
NAMES = re.findall(r"^TEST\((\w+)\)$", (HERE / "host" / "test_logic.c").read_text(), re.M)


def test_every_logic_test_is_run(logic_tests):
    assert len(NAMES) > 40 and run_program(logic_tests, "--list").stdout.split() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_logic(logic_tests, name):
    outcome = run_program(logic_tests, name)
    assert outcome.returncode == 0, outcome.stderr


def test_hostile_bytes_neither_crash_nor_drive(compiler, tmp_path):
    fuzzer = build_program("fuzz.c", tmp_path)
    (executed, drove_on, stopped), problem = fuzz.fuzzed(fuzzer, 60000, 1)
    assert (executed, problem) == (60000, "")
    # The armed inputs reach both ends, or the fuzzer proves nothing.
    assert drove_on > 1000 and stopped > 1000


FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def make(folder, *arguments):
    return subprocess.run(
        ["make", "-s", "-C", FIRMWARE, f"BUILD={folder}", *arguments],
        capture_output=True, text=True,
    )


def test_image_fits_its_budgets_and_one_beyond_them_fails_the_build(firmware_image):
    outcome = make(firmware_image.parent)
    assert outcome.returncode == 0, outcome.stderr
    assert firmware_image.with_suffix(".hex").read_text().startswith(":")
    flash, flash_budget, ram, ram_budget = (
        int(word) for word in outcome.stdout.split() if word.isdigit()
    )
    assert 4000 < flash <= flash_budget and 400 < ram <= ram_budget
    for budget in ("FLASH_BUDGET=5000", "RAM_BUDGET=500"):
        assert make(firmware_image.parent, budget).returncode != 0


@pytest.mark.parametrize(
    "config", ["PEAK_LIMIT_MA=30000", "MAX_COMMAND_MV=16000", "COMMAND_TIMEOUT_MS=0"]
)
def test_limits_that_cannot_be_kept_do_not_build(avr_toolchain, tmp_path, config):
    outcome = make(tmp_path, f"CONFIG=-D{config}")
    assert outcome.returncode != 0 and "static assertion failed" in outcome.stderr


def test_sketch_has_every_source_of_the_makefile_and_no_other():
    """The Arduino IDE compiles each .c file beside the .ino."""
    listed = next(
        text for text in (FIRMWARE / "Makefile").read_text().splitlines()
        if text.startswith("SOURCES")
    )
    assert sorted(listed.split()[2:]) == sorted(path.name for path in FIRMWARE.glob("*.c"))
    assert (FIRMWARE / f"{FIRMWARE.name}.ino").exists()


def test_arduino_ide_flags_build_it_too(avr_toolchain, tmp_path):
    objects = []
    for source in [*sorted(FIRMWARE.glob("*.c")), FIRMWARE / "firmware.ino"]:
        objects.append(tmp_path / f"{source.name}.o")
        language = ["-x", "c++", "-std=gnu++11"] if source.suffix == ".ino" else ["-std=gnu11"]
        subprocess.run(
            ["avr-gcc", "-c", "-g", "-Os", "-w", *language, "-ffunction-sections",
             "-fdata-sections", "-MMD", "-flto", "-mmcu=atmega328p", "-DF_CPU=16000000L",
             "-DARDUINO=10819", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR", source, "-o",
             objects[-1]],
            check=True,
        )
    subprocess.run(
        ["avr-gcc", "-w", "-Os", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections",
         "-mmcu=atmega328p", "-o", tmp_path / "sketch.elf", *objects, "-lm"],
        check=True,
    )


ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "hardware.md").read_text()
DRAWING = (ROOT / "docs" / "hardware.svg").read_text()
ANALOG = {
    "FRONT_CURRENT": "front current", "BACK_CURRENT": "back current", "SUPPLY": "supply",
    "FRONT_RANGE": "front range", "BACK_RANGE": "back range",
}
# Arduino's names of the port pins that an Uno brings out.
DIGITAL = {"PD6": "D6", "PD5": "D5", "PB3": "D11", "PD3": "D3", "PD4": "D4"}


def test_pins_outputs_and_limits_are_those_of_the_firmware():
    pwm, sampling, config = (
        (FIRMWARE / name).read_text() for name in ("pwm.c", "sampling.c", "config.h")
    )
    # From the comments at the output masks, whose pins the emulated runs prove, and the inputs.
    coded = {}
    for mask, comment in re.findall(r"#define \w+_PINS (.+?)/\* (.+?) \*/", pwm):
        ports = re.findall(r"_BV\((P\w\d)\)", mask)
        coded |= {DIGITAL[p]: c for p, c in zip(ports, comment.split(", "), strict=True)}
    inputs = re.findall(r"\[([A-Z_]+)\] = (\d)", sampling)
    coded |= {f"A{number}": ANALOG[name] for name, number in inputs}
    assert len(coded) == 10
    assert dict(re.findall(r"^\| ([AD]\d+) \| ([\w ]+?) \|", PAGE, re.MULTILINE)) == coded
    assert {pin for pin, name in coded.items() if f">{pin} {name}<" in DRAWING} == set(coded)
    source = (ROOT / "test" / "tools" / "uno" / "uno.c").read_text()
    names = [DIGITAL[f"P{port}{pin}"] for port, pin in re.findall(r"\{'(\w)', (\d), 0x", source)]
    order = re.search(r"#define CHANNELS 4 +/\* (.+?) \*/", config)
    assert order is not None
    assert [coded[name] for name in names] == order[1].split(", ")
    limits = dict(re.findall(r"#define (\w+) (\d+)", config))
    documented = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", PAGE, re.MULTILINE))
    assert len(documented) == 14
    assert {name: limits[name] for name in documented} == documented



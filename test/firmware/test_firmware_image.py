"""The firmware: its logic on this computer, its image and budgets, the documented pins; and the
checks of the emulated bench that are scripts."""

import re
import subprocess
from pathlib import Path

import pytest
from host_firmware import FIRMWARE, HERE, build_program
from uno import emulated_uno

from examination.check import fuzz, hardware
from sma_bench.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
NAMES = re.findall(r"^TEST\((\w+)\)$", (HERE / "host" / "test_logic.c").read_text(), re.M)


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, timeout=120.0)


@pytest.fixture(scope="module")
def logic_tests(compiler, tmp_path_factory):
    """test_logic.c under sanitizers."""
    return build_program("test_logic.c", tmp_path_factory.mktemp("logic"))


def test_every_logic_test_is_run(logic_tests):
    assert len(NAMES) > 40 and run(logic_tests, "--list").stdout.split() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_logic(logic_tests, name):
    outcome = run(logic_tests, name)
    assert outcome.returncode == 0, outcome.stderr


def test_hostile_bytes_neither_crash_nor_drive_and_fuzzing_tells_a_part_that_failed(
    compiler, tmp_path
):
    fuzzer = build_program("fuzz.c", tmp_path)
    (executed, drove_on, stopped), problem = fuzz.fuzzed(fuzzer, 60000, 1)
    assert (executed, problem) == (60000, "")
    # The armed inputs must reach both outcomes, or the fuzzer proves nothing.
    assert drove_on > 1000 and stopped > 1000
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\necho 'input 7: driven in silence' >&2; exit 134\n")
    program.chmod(0o755)
    assert fuzz.fuzzed(program, 10, 5) == ((0, 0, 0), "seed 5: input 7: driven in silence")


def make(folder, *arguments):
    return run("make", "-s", "-C", FIRMWARE, f"BUILD={folder}", *arguments)


def test_image_fits_its_budgets_and_one_beyond_them_fails_the_build(firmware_image):
    outcome = make(firmware_image.parent)
    assert outcome.returncode == 0, outcome.stderr
    assert firmware_image.with_suffix(".hex").read_text().startswith(":")
    flash, flash_budget, ram, ram_budget = map(int, re.findall(r"\b\d+\b", outcome.stdout))
    assert 4000 < flash <= flash_budget and 400 < ram <= ram_budget
    for budget in ("FLASH_BUDGET=5000", "RAM_BUDGET=500"):
        assert make(firmware_image.parent, budget).returncode != 0


@pytest.mark.parametrize("config", ["PEAK_LIMIT_MA=30000", "MAX_COMMAND_MV=16000"])
def test_limits_that_cannot_be_kept_do_not_build(firmware_image, tmp_path, config):
    outcome = make(tmp_path, f"CONFIG=-D{config}")
    assert outcome.returncode != 0 and "static assertion failed" in outcome.stderr


def test_without_the_tools_or_a_firmware_that_compiles_a_check_is_one_line(
    firmware_image, tmp_path, monkeypatch, capsys
):
    with pytest.raises(InputError, match="^make: [^\n]+$"):
        emulated_uno.build_firmware(tmp_path, "-DCOMMAND_TIMEOUT_MS=0")
    monkeypatch.setattr(emulated_uno.shutil, "which", lambda name: None)
    assert hardware.main([]) == 2
    error = capsys.readouterr().err
    assert "gcc-avr" in error and error.count("\n") == 1


def test_arduino_ide_flags_build_it_too_of_every_source_of_the_makefile(firmware_image, tmp_path):
    """The Arduino IDE compiles each .c file beside the .ino."""
    sources, sketch = sorted(FIRMWARE.glob("*.c")), FIRMWARE / f"{FIRMWARE.name}.ino"
    listed = re.search(r"^SOURCES.*", (FIRMWARE / "Makefile").read_text(), re.M)[0].split()[2:]
    assert sorted(listed) == [path.name for path in sources]
    flags = "-Os -w -flto -ffunction-sections -fdata-sections -mmcu=atmega328p -DF_CPU=16000000L"
    flags += " -DARDUINO=10819 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR"
    objects = []
    for source in (*sources, sketch):
        objects.append(tmp_path / f"{source.name}.o")
        language = "-x c++ -std=gnu++11" if source == sketch else "-std=gnu11"
        command = f"avr-gcc -c -g {language} {flags}".split()
        assert run(*command, source, "-o", objects[-1]).returncode == 0
    flags += " -fuse-linker-plugin -Wl,--gc-sections"
    outcome = run("avr-gcc", *flags.split(), "-o", tmp_path / "sketch.elf", *objects, "-lm")
    assert outcome.returncode == 0, outcome.stderr


ANALOG = {"FRONT_CURRENT": "front current", "BACK_CURRENT": "back current", "SUPPLY": "supply",
          "FRONT_RANGE": "front range", "BACK_RANGE": "back range"}  # fmt: skip
# Arduino's names of the port pins on an Uno's headers.
DIGITAL = {"PD6": "D6", "PD5": "D5", "PB3": "D11", "PD3": "D3", "PD4": "D4"}


def test_pins_outputs_and_limits_are_those_of_the_firmware():
    page, drawing, source, pwm, sampling, config = (
        (ROOT / name).read_text()
        for name in ("docs/hardware.md", "docs/hardware.svg", "test/tools/uno/uno.c",
                     "firmware/pwm.c", "firmware/sampling.c", "firmware/config.h")
    )
    # From the comments at the output masks (the emulated runs check these pins) and at the inputs.
    coded = {}
    for mask, comment in re.findall(r"#define \w+_PINS (.+?)/\* (.+?) \*/", pwm):
        ports = re.findall(r"_BV\((P\w\d)\)", mask)
        coded |= {DIGITAL[p]: c for p, c in zip(ports, comment.split(", "), strict=True)}
    inputs = re.findall(r"\[([A-Z_]+)\] = (\d)", sampling)
    coded |= {f"A{number}": ANALOG[name] for name, number in inputs}
    assert len(coded) == 10
    assert dict(re.findall(r"^\| ([AD]\d+) \| ([\w ]+?) \|", page, re.M)) == coded
    assert {pin for pin, name in coded.items() if f">{pin} {name}<" in drawing} == set(coded)
    names = [DIGITAL[f"P{port}{pin}"] for port, pin in re.findall(r"\{'(\w)', (\d), 0x", source)]
    order = re.search(r"#define CHANNELS 4 +/\* (.+?) \*/", config)
    assert [coded[name] for name in names] == order[1].split(", ")
    limits = dict(re.findall(r"#define (\w+) (\d+)", config))
    documented = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", page, re.M))
    assert len(documented) == 15
    assert {name: limits[name] for name in documented} == documented


# --- checks


@pytest.mark.acceptance
def test_a_wire_is_identified_over_a_serial_port_and_through_a_camera(emulator, tmp_path, capfd):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    status = hardware.main(["--out", str(tmp_path / "bench")])
    said = capfd.readouterr()
    assert status == 0, said.out + said.err
    assert (tmp_path / "bench" / "identified.yaml").is_file()

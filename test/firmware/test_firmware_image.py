"""The image for the Uno: its budgets, and that the Arduino IDE's way of building works."""

import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def make(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["make", "-s", "-C", FIRMWARE, f"BUILD={folder}", *arguments],
        capture_output=True, text=True,
    )


def test_image_fits_its_budgets(firmware_image: Path) -> None:
    outcome = make(firmware_image.parent)
    assert outcome.returncode == 0, outcome.stderr
    assert firmware_image.with_suffix(".hex").read_text().startswith(":")
    flash, flash_budget, ram, ram_budget = (
        int(word) for word in outcome.stdout.split() if word.isdigit()
    )
    assert 4000 < flash <= flash_budget
    assert 400 < ram <= ram_budget


@pytest.mark.parametrize("budget", ["FLASH_BUDGET=5000", "RAM_BUDGET=500"])
def test_image_beyond_a_budget_fails_the_build(firmware_image: Path, budget: str) -> None:
    assert make(firmware_image.parent, budget).returncode != 0


@pytest.mark.parametrize(
    "config",
    ["-DPEAK_LIMIT_MA=30000", "-DMAX_COMMAND_MV=16000", "-DCOMMAND_TIMEOUT_MS=0",
     "-DBAUD_RATE=230400UL"],
)
def test_limits_that_cannot_be_kept_do_not_build(
    avr_toolchain: str, tmp_path: Path, config: str
) -> None:
    outcome = make(tmp_path, f"CONFIG={config}")
    assert outcome.returncode != 0
    assert "static assertion failed" in outcome.stderr


def test_sketch_has_every_source_of_the_makefile_and_no_other() -> None:
    """The Arduino IDE compiles each .c file beside the .ino."""
    listed = next(
        text for text in (FIRMWARE / "Makefile").read_text().splitlines()
        if text.startswith("SOURCES")
    )
    assert sorted(listed.split()[2:]) == sorted(path.name for path in FIRMWARE.glob("*.c"))
    assert (FIRMWARE / f"{FIRMWARE.name}.ino").exists()


def test_arduino_ide_flags_build_it_too(avr_toolchain: str, tmp_path: Path) -> None:
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

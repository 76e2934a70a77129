"""The firmware's logic, built once for all tests, and hosts of an Uno with the real image."""

import shutil

import pytest
from host_firmware import HostFirmware, build_host_firmware, build_program
from virtual_host import VirtualHost


@pytest.fixture(scope="session")
def compiler():
    """A C compiler for this computer."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) here")


@pytest.fixture(scope="session")
def avr_toolchain():
    """The compiler for the Uno."""
    if shutil.which("avr-gcc") is None:
        pytest.skip("no avr-gcc here (Debian packages gcc-avr, binutils-avr, avr-libc)")


@pytest.fixture(scope="session")
def logic_tests(compiler, tmp_path_factory):
    """test_logic.c under sanitizers."""
    return build_program("test_logic.c", tmp_path_factory.mktemp("logic"))


@pytest.fixture(scope="session")
def host_library(compiler, tmp_path_factory):
    """The firmware's logic as a shared library."""
    return build_host_firmware(tmp_path_factory.mktemp("host_firmware"))


@pytest.fixture
def host_firmware(host_library):
    """The firmware's logic on this computer, just started; one at a time."""
    return HostFirmware(host_library)


@pytest.fixture
def host(uno):
    """A host in virtual time on an Uno that has greeted."""
    host = VirtualHost(uno)
    host.run(0.2)
    return host


@pytest.fixture
def driving(host):
    """The same, armed and driving 6 V on the first channel and 3 V on the last one."""
    host.arm()
    host.drive(6000, 0, 0, 3000)
    host.run(0.06)
    return host

"""The firmware's logic, built once for all tests, and hosts of an Uno with the real image."""

import shutil

import pytest
from host_firmware import HostFirmware, build_host_firmware
from virtual_host import VirtualHost


@pytest.fixture(scope="session")
def compiler():
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) here")


@pytest.fixture(scope="session")
def host_library(compiler, tmp_path_factory):
    return build_host_firmware(tmp_path_factory.mktemp("host_firmware"))


@pytest.fixture
def host_firmware(host_library):
    return HostFirmware(host_library)


@pytest.fixture
def host(uno):
    host = VirtualHost(uno)
    host.run(0.2)
    return host


@pytest.fixture
def driving(host):
    host.arm()
    host.drive(6000, 0, 0, 3000)
    host.run(0.06)
    return host

"""Fixtures of the stress tests."""

import pytest

from postfx.frame import Frame
from postfx.runtime import Device, DeviceError
from tests.stress.scenes import room


@pytest.fixture(scope="session")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="session")
def gpu() -> Device:
    """Skips where there is none."""
    try:
        return Device("cuda")
    except DeviceError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def rooms() -> list[Frame]:
    """Frames that no test may change."""
    return room()

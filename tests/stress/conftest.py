"""Fixtures of the stress tests."""

import pytest

from postfx.frame import Frame
from postfx.runtime import Device, DeviceError
from tests.stress.scenes import PROVIDERS, room

ANY_CONTENT = ("test_any_input", "test_bad_pixels", "test_hard_inputs", "test_hard_planes")
"""Tests in which the doctor, too, meets frames that no renderer makes."""


@pytest.fixture(autouse=True)
def unseen(request: pytest.FixtureRequest) -> None:
    """The others look for what the passes do."""
    if request.path.stem not in ANY_CONTENT:
        request.getfixturevalue("no_first_look")


@pytest.fixture(scope="session")
def cpu() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="session")
def gpu() -> Device:
    """Skips where there is none."""
    try:
        return Device("cuda")
    except DeviceError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session", params=PROVIDERS)
def device(request: pytest.FixtureRequest) -> Device:
    """Each in turn: a test runs on all of them, unless it is `on` some or takes the fixture of
    one."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def rooms() -> list[Frame]:
    """Frames that no test may change."""
    return room()

"""What tests of frames in reverse order share."""

from __future__ import annotations

import pytest

from postfx.runtime import Device


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)

"""Fixtures shared by all tests."""

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Folder `shared` beside the checkout, with sequences that other software rendered; skips where it is absent."""
    folder = REPOSITORY.parent / "shared"
    if not (folder / "sequences").is_dir():
        pytest.skip(f"{folder} is not there")
    return folder

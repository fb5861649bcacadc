"""Scenes made by others that no training may show: they are kept for validation.

Needs nothing but Python, so that Blender's and Mitsuba's loaders both can ask it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

SCENES = frozenset({
    "bathroom", "chess-board", "cloth-folds", "desk-fan", "dispersion-test", "flight-helmet", "fox",
    "hotel-room", "japanese-temple", "kaykit-mage", "love-neon", "marble-tower", "market-vehicles",
    "ploy-house",
})


def for_training(folders: Iterable[Path]) -> list[Path]:
    """Folders of scenes without those that are held back."""
    return [folder for folder in folders if folder.name not in SCENES]


def refuse(name: str) -> None:
    """Raise ValueError for a scene that is held back."""
    if name in SCENES:
        raise ValueError(f"scene '{name}' is held back for validation: train on another one")

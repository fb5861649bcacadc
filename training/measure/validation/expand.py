"""From compact clips to EXR sequences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from training.datagen.clip_file import GUIDES
from training.datagen.to_exr import frame_header, write_exr
from training.measure.validation.pack import load
from training.measure.validation.plan import FULL


def expand(clip: Path, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Write reference, guides and all renders of a clip to FOLDER/SCENE.SEED/NAME.####.exr; that folder and the facts.

    What was written of this file is kept.
    """
    reference, renders, facts = load(clip)
    folder = folder / f"{facts['scene']}.{facts['seed']}"
    done = folder / "done"
    if done.exists() and done.stat().st_mtime >= clip.stat().st_mtime:
        return folder, facts
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.exr"):
        old.unlink()
    exposure = facts["exposure"]
    renders.setdefault("guides", {name: renders[FULL.name][name] for name in GUIDES})
    for t, colour in enumerate(reference):
        header = {"postfx:exposure": exposure, "postfx:spp": facts["reference_spp"]}
        write_exr(folder / f"reference.{t + 1:04d}.exr", {"colour": colour}, header)
        for name, planes in renders.items():
            frame = {plane: values[t] for plane, values in planes.items()}
            write_exr(folder / f"{name}.{t + 1:04d}.exr", frame, _header(name, t, facts))
    done.touch()
    return folder, facts


def _header(name: str, t: int, facts: dict[str, Any]) -> dict[str, Any]:
    if name == "guides":
        return {"postfx:jitter": np.array(facts["renders"][FULL.name]["jitter"][t])}
    render = facts["renders"][name]
    return frame_header(np.array(facts["to_world"][t]), facts["fov"][t], np.array(render["jitter"][t]), render["spp"],
                        facts["exposure"], bool(facts["reset"][t]))

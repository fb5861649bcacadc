"""Measure every method on every render of the clips, and report means over them.

PSNR is that of `postfx bench` without the reference's own noise, known from its halves.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from postfx.tools.bench.job import Bench, Request
from postfx.tools.bench.measure import Sources
from training.datagen.clip_file import GUIDES, frame_header, write_exr
from training.measure.validation.clips import FULL, HALF, load

# Measurements -------------------------------------------------------------------------------------

FIGURES = ("ssim", "flip", "flicker")


def compare(clips: list[Path], args: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each clip, render and method. Files go to RESULTS/SCENE.SEED/RENDER, EXR frames to
    RESULTS/frames."""
    rows = []
    for clip in clips:
        folder, facts = expand(clip, args.results / "frames")
        for name in [name for name in facts["renders"] if name in args.renders.split(",")]:
            print(f"{folder.name} {name}", file=sys.stderr, flush=True)
            rows += [_row(folder.name, name, facts, method)
                     for method in _measured(folder, name, args)]
    return rows


def _measured(folder: Path, name: str, args: argparse.Namespace) -> list[dict[str, Any]]:
    output = args.results / folder.name / name
    earlier = output / "bench.json"
    if args.keep and earlier.exists():
        return json.loads(earlier.read_text())["methods"]
    patterns = [str(folder / f"{part}.####.exr") for part in (name, "reference", "guides")]
    wish = Request(output, args.methods, args.models, args.runs, args.device)
    return Bench(Sources(*patterns), wish).run()["methods"]


def _row(scene: str, name: str, facts: dict[str, Any], method: dict[str, Any]) -> dict[str, Any]:
    scores, render = method["scores"], facts["renders"][name]
    pairs = zip(method["frames"], facts["reference_noise"], strict=True)
    psnr = [without_noise(frame["psnr"], noise) for frame, noise in pairs]
    return {
        "scene": scene, "trait": facts["trait"], "style": facts["style"], "render": name,
        "scale": render["scale"],
        "spp": render["spp"], "method": method["name"], "family": method["family"],
        "wall_ms": method["time"]["wall_ms"], "psnr": mean(psnr),
        "psnr_late": mean(psnr[len(psnr) // 2 :]),
        **{key: scores[key] for figure in FIGURES for key in (figure, f"{figure}_late")},
        "psnr_frames": psnr, "reference_noise": facts["reference_noise"],
    }


def without_noise(psnr: float, noise: float) -> float:
    """PSNR without the reference's own noise (mean square); raised by 10 dB at most."""
    error = 10 ** (-psnr / 10)
    return float(-10 * np.log10(max(error - noise, error / 10)))


# Report -------------------------------------------------------------------------------------------
# Means over the clips: a table for each scale, and one for the two ways to spend as many light
# paths.

COMPARED = ("psnr_late", "ssim_late", "flip_late", "flicker_late")
FRAMEWISE = "oidn-high"

Row = dict[str, Any]


def report(folder: Path, rows: list[Row]) -> None:
    """Write comparison.csv (a line for each clip, render and method) and comparison.json, and print
    the tables."""
    tables = {render: summary([row for row in rows if row["render"] == render])
              for render in dict.fromkeys(row["render"] for row in rows)}
    rays = equal_rays(tables)
    facts = {"scales": tables, "equal_rays": rays, "rows": rows}
    (folder / "comparison.json").write_text(json.dumps(facts, indent=1) + "\n")
    columns = [key for key, value in rows[0].items() if not isinstance(value, list)]
    with (folder / "comparison.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    for render, table in tables.items():
        print("\n".join([_title([row for row in rows if row["render"] == render]), *_lines(table),
                         ""]))
    if rays:
        print("\n".join(["equally many light paths; gain over the best of OIDN at full size",
                         *_lines(rays)]))


def summary(rows: list[Row]) -> list[Row]:
    """A row for each method of one render: means over the clips, and comparisons with OIDN if it
    was measured.

    `gain`: PSNR above the OIDN method with the best mean; `flip_ratio`, `flicker_ratio`: quotients
    to the least of the OIDN methods. `least_gain`: least lead in PSNR over a clip's best OIDN
    method, of all clips. `worst_frame`: least lead in PSNR of a single frame over OIDN high, of all
    frames.
    """
    by_method = {name: [row for row in rows if row["method"] == name]
                 for name in dict.fromkeys(row["method"] for row in rows)}
    means = [_means(own) for own in by_method.values()]
    baselines = [row for row in means if row["family"] == "oidn"]
    for row in means:
        own = by_method[row["method"]]
        row |= _against(row, baselines)
        row["least_gain"] = min((gain for one in own
                                 if (gain := _clip_gain(one, rows)) is not None), default=None)
        row["worst_frame"] = _worst_frame(own, by_method.get(FRAMEWISE, []))
    return means


def equal_rays(tables: dict[str, list[Row]]) -> list[Row]:
    """Methods at half and at full size, compared with the best of OIDN at full size; empty unless
    both are there."""
    full, half = tables.get(FULL.name, []), tables.get(HALF.name, [])
    baselines = [row for row in full if row["family"] == "oidn"]
    if not half or not baselines:
        return []
    keys = ("family", "clips", "wall_ms", *COMPARED)
    ways = {f"half, {HALF.spp} spp": half, f"full, {FULL.spp} spp": full}
    plain = [{"method": f"{row['method']} ({way})"} | {key: row[key] for key in keys}
             for way, table in ways.items() for row in table]
    return [row | _against(row, baselines) for row in plain]


def _means(rows: list[Row]) -> Row:
    found = {"method": rows[0]["method"], "family": rows[0]["family"], "clips": len(rows)}
    return found | {key: mean([row[key] for row in rows]) for key in ("wall_ms", *COMPARED)}


def _against(row: Row, baselines: list[Row]) -> Row:
    best = {key: [other[key] for other in baselines if other[key] is not None] for key in COMPARED}
    found: Row = {"gain": row["psnr_late"] - max(best["psnr_late"]) if best["psnr_late"] else None}
    for key in ("flip", "flicker"):
        value, others = row[f"{key}_late"], best[f"{key}_late"]
        found[f"{key}_ratio"] = value / min(others) if others and value is not None else None
    return found


def _clip_gain(row: Row, rows: list[Row]) -> float | None:
    """PSNR above the best OIDN method of the same clip."""
    others = [other["psnr_late"]
              for other in rows if other["scene"] == row["scene"] and other["family"] == "oidn"]
    return row["psnr_late"] - max(others) if others else None


def _worst_frame(rows: list[Row], framewise: list[Row]) -> float | None:
    """Least difference of a frame's PSNR to OIDN high's."""
    theirs = {row["scene"]: row["psnr_frames"] for row in framewise}
    gaps = [one - other for row in rows if row["scene"] in theirs
            for one, other in zip(row["psnr_frames"], theirs[row["scene"]], strict=True)]
    return min(gaps, default=None)


def mean(values: Sequence[float | None]) -> float | None:
    """Mean of the known values; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _title(rows: list[Row]) -> str:
    noise = np.mean([-10 * np.log10(np.mean(row["reference_noise"]) + 1e-12) for row in rows])
    clips = len({row["scene"] for row in rows})
    return (f"{rows[0]['scale']:g}x, {clips} clips; the references' own noise, {noise:.1f} dB, is "
            "taken out of PSNR")


def _lines(table: list[Row]) -> Iterator[str]:
    heads = {"wall_ms": ("ms", ".1f"), "psnr_late": ("PSNR", ".2f"), "ssim_late": ("SSIM", ".4f"),
             "flip_late": ("FLIP", ".4f"), "flicker_late": ("flicker", ".2f"),
             "gain": ("gain", "+.2f"),
             "flip_ratio": ("FLIP x", ".2f"), "flicker_ratio": ("flicker x", ".2f"),
             "least_gain": ("least", "+.2f"), "worst_frame": ("frame", "+.2f")}
    shown = [key for key in heads if key in table[0]]
    yield f"{'method':<38}" + "".join(f"{heads[key][0]:>10}" for key in shown)
    for row in table:
        cells = ["-" if row[key] is None else format(row[key], heads[key][1]) for key in shown]
        yield f"{row['method']:<38}" + "".join(f"{cell:>10}" for cell in cells)


# EXR sequences ------------------------------------------------------------------------------------

def expand(clip: Path, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Write reference, guides and all renders of a clip to FOLDER/SCENE.SEED/NAME.####.exr; that
    folder and the facts.

    Existing files of this clip are kept.
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
    return frame_header(np.array(facts["to_world"][t]), facts["fov"][t],
                        np.array(render["jitter"][t]), render["spp"],
                        facts["exposure"], bool(facts["reset"][t]))

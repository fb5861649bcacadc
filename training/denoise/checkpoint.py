"""Checkpoints of the denoised upscaler: their content, weights from them or from exported networks,
and mixtures.

    python -m training.denoise.checkpoint pack run/checkpoint.pt -o training/checkpoints/l.1x.pt
    python -m training.denoise.checkpoint mix a/checkpoint.pt:0.6 b/checkpoint.pt:0.4 -o mixed.pt
    python -m training.denoise.checkpoint mix a/checkpoint.pt:0.85 \\
        denoise_upscale.m.1x.onnx:0.15 -o mixed.pt

A checkpoint of a run holds everything that training needs to continue. One for export or --start
holds only `config`, `weights` and `notes`. `pack` writes one for the repository, from which a
training goes on (--continue). `mix` averages the weights of networks: on scenes of other renderers
the mean of two trainings is often better than either.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from postfx.kernels.denoise import BLEND, SHARPEN
from training.denoise.picture import ADDED_LAYERS

PREFIX, HALF = "trunk.", "_half"


def save(checkpoint: dict[str, Any], path: Path) -> None:
    """Write a checkpoint; an existing file is replaced at the end, in one step."""
    partial = path.with_suffix(".tmp")
    torch.save(checkpoint, partial)
    os.replace(partial, path)


def read(path: Path) -> dict[str, Any]:
    """A checkpoint, on the CPU."""
    return torch.load(path, map_location="cpu", weights_only=True)


def load_weights(path: Path, trust: bool = False) -> dict[str, Tensor]:
    """Averaged weights of a checkpoint, or the weights of an exported network, in float32.

    ``trust``: they are for a network that predicts its trust in the planes. An exported one that
    does not do so begins to trust them nearly everywhere.
    """
    if path.suffix != ".onnx":
        return {name: values.float() for name, values in read(path)["weights"].items()}
    card = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    weights = weights_of(path)
    return begin_trust(weights) if trust and not card["config"].get("trust") else weights


def begin_trust(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Turn the last hidden channel, which had another use, into the trust in the planes: nearly 1
    everywhere."""
    from postfx.kernels.denoise import FEATURES, FINE

    head = slice(4 * (FINE - 1), 4 * FINE)
    changed = {name: weights[PREFIX + name].clone()
               for name in ("fine.weight", "fine.bias", "stem.weight")}
    changed["fine.weight"][head] = 0
    changed["fine.bias"][head] = 2
    changed["stem.weight"][:, FEATURES - 1] = 0
    return weights | {PREFIX + name: values for name, values in changed.items()}


def weights_of(path: Path) -> dict[str, Tensor]:
    """Name -> float32 weights as a checkpoint holds them, from
    ``denoise_upscale.<tag>[.guides|.1x].onnx``.

    They are rounded to half precision, as the file stores them. Raises ValueError for variants of
    other precision.
    """
    import onnx  # needed only to start from an exported network
    from onnx import numpy_helper

    from training.denoise.model import logits_of
    from training.export import lower_constants

    found = {t.name.removesuffix(HALF): torch.from_numpy(numpy_helper.to_array(t).astype("float32"))
             for t in lower_constants(onnx.load(path)).graph.initializer}
    stored = {name: values for name, values in found.items() if "." in name or name == "rest"}
    if "judge.0.weight" in stored:  # a network that gives the picture
        return {PREFIX + name: values.contiguous() for name, values in stored.items()}
    if "fine.weight" not in stored:
        raise ValueError(f"{path}: no weights of the fine head: take the float32 model, as "
                         "denoise_upscale.m.onnx")
    alike = (found[level] for level in sorted(found) if level.startswith("level"))
    stored |= {f"alike.{i}": logits_of(level).half().float() for i, level in enumerate(alike)}
    stored["stem.bias"] = stored.pop("stems.0.bias")
    parts = sum(name.startswith("stems.") for name in stored)
    stored["stem.weight"] = torch.cat([stored.pop(f"stems.{i}.weight") for i in range(parts)], 1)
    return {PREFIX + name: values.contiguous() for name, values in stored.items()}


def widen(weights: dict[str, Tensor], wider: dict[str, Tensor]) -> dict[str, Tensor]:
    """The network of ``weights`` in the layout of ``wider``, which has more channels or levels: the
    same function.

    New channels keep their weights in ``wider``, but nothing that existed reads them yet, as in
    Net2Net (Chen, Goodfellow and Shlens, 2016). New levels begin with the filter that was the same
    at all pixels, and layers that add to a published network with nothing. Raises ValueError if the
    network does not fit into ``wider``.
    """
    found = {name: values.clone() for name, values in wider.items()}
    for name in found.keys() - weights.keys():
        if name.removeprefix(PREFIX).partition(".")[0] in ADDED_LAYERS:
            found[name].zero_()
    levels = count_levels(weights)
    for name, values in weights.items():
        word, _, place = name.removeprefix(PREFIX).partition(".")
        if name not in found and word in ("alike", "rest"):
            target = f"heads.{levels + int(place)}" if word == "alike" else f"lift.{levels - 1}"
            found[f"{PREFIX}{target}.weight"].zero_()
            name, values = f"{PREFIX}{target}.bias", values.flatten()
        if name not in found or any(a > b
                                    for a, b in zip(values.shape, found[name].shape, strict=True)):
            raise ValueError(f"{name} does not fit into the other network, which must be the wider "
                             "one")
        whole = found[name]
        if values.ndim > 1:
            whole[:values.shape[0], values.shape[1]:] = 0
        whole[tuple(slice(n) for n in values.shape)] = values
    return found


def keep_levels(weights: dict[str, Tensor], count: int) -> dict[str, Tensor]:
    """The network without its levels coarser than the finest ``count``: their filters become the
    same at all pixels, those of their heads' biases. The opposite of `widen` for a network whose
    coarse levels hardly matter."""
    levels = count_levels(weights)
    if not 0 < count <= levels:
        raise ValueError(f"the network has {levels} levels: --levels takes 1 to {levels}")
    found, heads = {}, {f"{PREFIX}heads.{i}.bias": f"{PREFIX}alike.{i - count}"
                        for i in range(count, levels)}
    for name, values in weights.items():
        word, level, *_ = *name.removeprefix(PREFIX).split("."), ""
        if name in heads:
            found[heads[name]] = values.reshape(1, -1, 1, 1)
        elif name == f"{PREFIX}lift.{count - 1}.bias":
            found[PREFIX + "rest"] = values.reshape(1, -1, 1, 1)
        elif word not in ("down", "up", "heads", "lift") or int(level) < count - (word == "lift"):
            found[name] = values
    return found


def count_levels(weights: dict[str, Tensor]) -> int:
    """Levels of the network, those not counted whose filters are the same at all pixels."""
    return sum(name.startswith(PREFIX + "heads.") and name.endswith("bias") for name in weights)


# State that a run continues with ------------------------------------------------------------------

def git_commit() -> str:
    """The commit of this code, marked if files differ from it; 'unknown' outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True,
                              check=True)
        return done.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def pack(checkpoint: dict[str, Any]) -> dict[str, Any]:
    """A checkpoint small enough for the repository, from which `unpack` lets a training go on:
    weights and their average in half precision. Adam's moments are left out, as a few hundred steps
    bring them back."""
    halves = {key: {name: values.half() for name, values in checkpoint[key].items()}
              for key in ("live", "weights")}
    kept = ("config", "notes", "step", "seconds", "seed", "commit", "arguments")
    return {key: checkpoint[key] for key in kept} | halves


def unpack(path: Path) -> dict[str, Any]:
    """A checkpoint of `pack`, its weights in float32. Raises ValueError for one that holds an
    average alone."""
    found = read(path)
    if "live" not in found:
        raise ValueError(f"{path}: no state to continue from: take the file that 'checkpoint pack' "
                         "wrote")
    return found | {key: {name: values.float() for name, values in found[key].items()}
                    for key in ("live", "weights")}


# Mixtures -----------------------------------------------------------------------------------------

NEWER_LOGITS = {PREFIX + "controls.bias": slice(0, 1),
                PREFIX + "fine.bias": slice(4 * BLEND, 4 * SHARPEN)}
"""By layer, of a picture network and of one that predicts filters: where the logits of the new
picture's share beside the history are."""


def mix(parts: Sequence[tuple[Path, float]], levels: int | None = None,
        newer: float = 0.0) -> dict[str, Any]:
    """A checkpoint with the weighted mean of several weights; its notes are the first one's, and
    name the mixture.

    The first part is a checkpoint; others may be exported networks, also with fewer channels or
    levels. Of the mean, the finest ``levels`` stay (None: all). ``newer`` raises the share of the
    new picture beside the history, in logits. Raises ValueError if shares do not add up to 1 or a
    network does not fit.
    """
    if abs(sum(share for _, share in parts) - 1) > 1e-6:
        raise ValueError(f"shares add up to {sum(share for _, share in parts):g}, not to 1")
    if parts[0][0].suffix == ".onnx":
        raise ValueError(f"{parts[0][0]}: an exported network cannot be the first part: begin with "
                         "a checkpoint")
    first = read(parts[0][0])
    found, read_parts = [], []
    for path, share in parts:
        if path.suffix == ".onnx":
            one = first | {"weights": load_weights(path, bool(first["config"].get("trust")))}
        else:
            one = read(path)
            read_parts.append(one)
        try:
            found.append((widen(one["weights"], first["weights"]), share))
        except ValueError as fault:
            raise ValueError(f"{path}: another layout than {parts[0][0]}: {fault}") from None
    weights = {name: sum(share * one[name].float() for one, share in found)
               for name in first["weights"]}
    told = " + ".join(f"{share:g} {path}" for path, share in parts)
    starts = [one["notes"]["start"] for one in read_parts if "start" in one["notes"]]
    begun = {"start": starts[-1]} if starts else {}
    config = first["config"]
    if levels is not None:
        weights, config = keep_levels(weights, levels), {**config,
                                                         "widths": config["widths"][:levels]}
    if newer:
        name = next(name for name in NEWER_LOGITS if name in weights)
        weights[name][NEWER_LOGITS[name]] += newer
        told += f", new pictures {newer:+g} logits"
    notes = {**first["notes"], **begun, "weights": told}
    return {"config": config, "weights": weights, "notes": notes}


def graft(base: Path, donor: Path, layers: Sequence[str]) -> dict[str, Any]:
    """The checkpoint `base`, which lacks some ``layers`` of its network (first words of their
    names, as 'branch'), with those of another network. Raises ValueError if the other one lacks
    them, too."""
    found, given = read(base), read(donor)["weights"]
    added = {name: values for name, values in given.items()
             if name.removeprefix(PREFIX).partition(".")[0] in layers}
    if missing := set(layers) - {name.removeprefix(PREFIX).partition(".")[0] for name in added}:
        raise ValueError(f"{donor}: no layer {', '.join(sorted(missing))}")
    notes = {**found["notes"], "grafted": f"{', '.join(layers)} of {donor}"}
    return {"config": found["config"], "weights": added | found["weights"], "notes": notes}


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack",
                                  help="make a run's checkpoint small enough for the repository")
    packing.add_argument("checkpoint", type=Path)
    packing.add_argument("-o", "--output", type=Path, required=True, help="checkpoint to write")
    packing.set_defaults(make=lambda args: pack(read(args.checkpoint)))
    mixing = commands.add_parser("mix",
                                 help="average the weights of networks; smaller ones are widened "
                                 "to the first")
    mixing.add_argument("parts", nargs="+", type=part, metavar="FILE:SHARE",
                        help="checkpoints or exported networks; shares add up to 1")
    mixing.add_argument("--levels", type=int, metavar="N",
                        help="keep the N finest levels (default: all)")
    mixing.add_argument("--newer", type=float, default=0.0, metavar="LOGITS",
                        help="raise the new picture's share beside the history")
    mixing.add_argument("-o", "--output", type=Path, required=True, help="checkpoint to write")
    grafting = commands.add_parser("graft",
                                   help="give a network the layers of another one that it lacks")
    grafting.add_argument("base", type=Path,
                          help="checkpoint, as of training.denoise.open_weights --large")
    grafting.add_argument("donor", type=Path, help="checkpoint of a network that has the layers")
    grafting.add_argument("--layers", nargs="+", default=["branch"], metavar="LAYER",
                          help="first words of their names (default: branch)")
    grafting.add_argument("-o", "--output", type=Path, required=True, help="checkpoint to write")
    grafting.set_defaults(make=lambda args: graft(args.base, args.donor, args.layers))
    mixing.set_defaults(make=lambda args: mix(args.parts, args.levels, args.newer))
    return parser


def main(argv: Sequence[str] | None = None) -> None:
    parser = options()
    args = parser.parse_args(argv)
    try:
        save(args.make(args), args.output)
    except (OSError, ValueError) as fault:
        parser.error(str(fault))


def part(word: str) -> tuple[Path, float]:
    """'a.pt:0.6' as a file and its share."""
    path, _, share = word.rpartition(":")
    try:
        return Path(path), float(share)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{word}' is not FILE:SHARE, as "
                                         "a/checkpoint.pt:0.6") from None


if __name__ == "__main__":
    main()

"""Pack HDR pictures and baked looks into one .npz for `train --set`, for a machine without OpenColorIO.

    python -m training.tonemap.make_set -o set.npz --looks local auto --photos 'hdr/*.exr' --panoramas 'env/*.hdr'

Pictures named by --hold-out are never trained on: they become validation pairs, whose targets are made by the colour
pipeline itself and not by its baked cube. --clips takes a folder of .npz files with a `reference` (T,H,W,3).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from postfx.colour.primaries import LINEAR_SPACES
from training.tonemap.looks import find_look
from training.tonemap.pictures import collect, lesson, save


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--looks", nargs="+", default=["local", "auto"], help="built-in looks, or .toml files")
    parser.add_argument("--photos", nargs="*", default=[], help="HDR photographs (patterns)")
    parser.add_argument("--panoramas", nargs="*", default=[], help="equirectangular HDR environments (patterns)")
    parser.add_argument("--clips", help="folder of rendered clips (.npz with `reference`)")
    parser.add_argument("--clip-limit", type=int, default=12)
    parser.add_argument("--hold-out", nargs="*", default=[], help="file stems kept for validation")
    parser.add_argument("--side", type=int, default=768, help="longest side of a photograph")
    parser.add_argument("--space", choices=LINEAR_SPACES, help="primaries of the files, linear; default: by header")
    args = parser.parse_args()
    pictures = collect(args.photos, args.panoramas, args.clips, args.clip_limit, args.hold_out, args.side, args.space)
    lessons = {Path(name).stem: lesson(find_look(name), pictures) for name in args.looks}
    save(args.output, pictures, lessons)
    size = Path(args.output).stat().st_size / 2**20
    print(f"{args.output}: {len(pictures.train)} pictures, {len(pictures.held)} held out, {size:.1f} MiB")


if __name__ == "__main__":
    main()

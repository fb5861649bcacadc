#!/usr/bin/env bash
# Convert scenes and environment maps into one archive for the machine that renders.
# usage: pack_scenes.sh SCENES_FOLDER ENVIRONMENTS_FOLDER OUTPUT.tar.xz
# SCENES_FOLDER holds NAME.tar.xz archives (or unpacked folders); unpack OUTPUT and give its folder to --real.
set -euo pipefail
scenes=$(realpath "$1"); environments=$(realpath "$2"); out=$(realpath -m "$3")
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
mkdir -p "$work/source" "$work/real/environments"
for archive in "$scenes"/*.tar.xz; do [ -e "$archive" ] && tar -C "$work/source" -xf "$archive"; done
for folder in "$scenes"/*/; do [ -d "$folder" ] && cp -r "$folder" "$work/source/"; done
"${PYTHON:-python3}" -m training.datagen.scenes.convert "$work/source" "$work/real"
install -m 644 "$environments"/*.hdr "$work/real/environments/"
tar -C "$work" -cf - real | xz -6 -T0 >"$out"
ls -la "$out"

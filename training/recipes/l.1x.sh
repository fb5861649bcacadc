#!/usr/bin/env bash
# Render, clean and train on one machine: the network for the render's own size, from the recipe of its data.
#
# usage: l.1x.sh WORK MINUTES [CHECKPOINT]
#   WORK        folder for clips, logs and the run; WORK/run/checkpoint.pt is written every two minutes, and
#               WORK/l.1x.pt at the end: 0.4 of the trained weights and 0.6 of the published ones, for
#               python -m training.denoise.export WORK/l.1x.pt --tag l.1x --network-only
#   MINUTES     of the whole, of which the last fifth of the training lowers the rate
#   CHECKPOINT  packed state to go on from (training.denoise.checkpoint pack)
#
#   BLENDER     Python with the module bpy and OpenImageIO (default: blender/run)
#   LIBRARY     glTF scenes, environments/*.hdr and pages/*.png (default: library)
#   SEED        of the clips: another one for each run, below 9000 (default: 1)
#   START       checkpoint of published weights (default: made by training.denoise.open_weights from the package pyoidn)
#   PROCESSES   of Blender (default: 26)
#
# With two GPUs the second one renders until the rate falls; with one, rendering ends before the training begins, as a
# training beside ten rendering processes stands still.
set -euo pipefail
work=$1 minutes=$2 checkpoint=${3:-}
blender=${BLENDER:-blender/run} library=${LIBRARY:-library} seed=${SEED:-1} processes=${PROCESSES:-26}
gpus=$(nvidia-smi -L | wc -l)
python=${PYTHON:-python3}
mkdir -p "$work/logs" "$work/raw"
began=$(date +%s)

# Minutes of rendering before the training begins: it compiles meanwhile if there is a GPU for each.
if [ "$gpus" -gt 1 ]; then
    renderer=1 head=1 rendering=$((minutes * 4 / 5))
else
    renderer=0 head=$((minutes / 4)) rendering=$head
fi
views=(--out "$work/raw" --gpus "$renderer" --processes-per-gpu "$processes" --minutes "$rendering" --seed "$seed"
    --blender "$blender" --real "$library" --clips 8000 --report 20
    --even-spp 128 --half-samples 160 --variants 3 --frames 4 --width 320 --height 192 --scale 1)
small=(--out "$work/mitsuba" --gpus 0 --processes-per-gpu 7 --minutes "$head" --seed "$((seed + 1))"
    --real "$library" --clips 4000 --report 20 --even-spp 128
    --reference-spp 256 --reference-error 0.008 --frames 4 --width 128 --height 128 --scale 1)

CUDA_VISIBLE_DEVICES=0 "$python" -m training.datagen.formula --out "$work/formula" --clips 96 --frames 4 --scale 1 \
    --seed "$seed" >"$work/logs/formula.log" 2>&1 &
"$python" -m training.datagen.render "${small[@]}" >"$work/logs/mitsuba.log" 2>&1 &
"$python" -m training.datagen.render "${views[@]}" >"$work/logs/cycles.log" 2>&1 &
start=${START:-$work/start.pt}
[ -e "$start" ] || "$python" -m training.denoise.open_weights -o "$start"
"$python" -m training.datagen.clean_references "$work/raw" "$work/views" --watch "$((rendering + 1))" >"$work/logs/clean.log" 2>&1 &

sleep "$((60 * head))"
left=$((60 * minutes - $(date +%s) + began))
CUDA_VISIBLE_DEVICES=0 "$python" -m training.denoise.train --clips "$work/views=3" "$work/mitsuba=2" "$work/formula" \
    --out "$work/run" --minutes "$("$python" -c "print($left / 60)")" --cool 0.3 \
    --picture --published-rate 0.01 --volumes --batch 16 --crop 128 --rate 3e-4 --flicker 1 \
    --even 4 --clean 0.1 --reset 0.07 --light 0.5 0.5 --false-motion 0.1 --sparse-planes 0.1 --blend 0.5 \
    --wait 50 $(if [ -n "$checkpoint" ]; then echo --continue "$checkpoint"; else echo --start "$start"; fi) >"$work/logs/train.log" 2>&1
wait
"$python" -m training.denoise.checkpoint mix "$work/run/checkpoint.pt:0.4" "$start:0.6" --newer 0.75 -o "$work/l.1x.pt"

#!/usr/bin/env bash
# Render, clean and train on one machine: a network for the render's own size, from the recipe of its data.
#
# usage: render_size.sh NETWORK WORK MINUTES [CHECKPOINT]
#   NETWORK     l or xl: the layout of Open Image Denoise's usual or large network
#   WORK        folder for clips, logs and the run; WORK/run/checkpoint.pt is written every two minutes, and
#               WORK/NETWORK.1x.pt at the end: a share of the trained weights and the rest of the published ones, for
#               python -m training.denoise.export WORK/xl.1x.pt --tag xl.1x --network-only
#   MINUTES     of the whole, of which the last third of the training lowers the rate
#   CHECKPOINT  weights to go on from, such as training/checkpoints/xl.1x.pt
#
#   BLENDER     Python with the module bpy and OpenImageIO (default: blender/run)
#   LIBRARY     glTF scenes, environments/*.hdr and pages/*.png (default: library)
#   SEED        of the clips: another one for each run, below 9000 (default: 1)
#   PUBLISHED   checkpoint of published weights (default: made by training.denoise.open_weights from the package pyoidn)
#   PROCESSES   of Blender (default: 26)
#
# With two GPUs the second one renders until the rate falls; with one, rendering ends before the training begins, as a
# training beside ten rendering processes stands still.
set -euo pipefail
network=$1 work=$2 minutes=$3 checkpoint=${4:-}
case $network in
    l) layout=() rates=(--published-rate 0.01 --rate 3e-4) share=0.4 newer=0.75 ;;
    xl) layout=(--large) rates=(--clean-planes 2 --published-rate 0.03 --rate 4e-4) share=0.85 newer=0.5 ;;
    *) echo "$0: there are the networks l and xl, not '$network'" >&2; exit 2 ;;
esac
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
small=(--out "$work/mitsuba" --gpus "$renderer" --processes-per-gpu 5 --minutes "$rendering" --seed "$((seed + 1))"
    --real "$library" --clips 4000 --report 20 --even-spp 128
    --reference-spp 256 --reference-error 0.008 --frames 4 --width 128 --height 128 --scale 1)

CUDA_VISIBLE_DEVICES=0 "$python" -m training.datagen.formula --out "$work/formula" --clips 160 --frames 4 --scale 1 \
    --seed "$seed" >"$work/logs/formula.log" 2>&1 &
"$python" -m training.datagen.render "${small[@]}" >"$work/logs/mitsuba.log" 2>&1 &
"$python" -m training.datagen.render "${views[@]}" >"$work/logs/cycles.log" 2>&1 &
published=${PUBLISHED:-$work/published.pt}
[ -e "$published" ] || "$python" -m training.denoise.open_weights "${layout[@]}" -o "$published"
"$python" -m training.datagen.clean_references "$work/raw" "$work/views" --watch "$((rendering + 1))" >"$work/logs/clean.log" 2>&1 &

sleep "$((60 * head))"
left=$((60 * minutes - $(date +%s) + began))
CUDA_VISIBLE_DEVICES=0 "$python" -m training.denoise.train --clips "$work/views=4" "$work/mitsuba" "$work/formula" \
    --out "$work/run" --minutes "$("$python" -c "print($left / 60)")" --cool 0.3 \
    --picture "${layout[@]}" "${rates[@]}" --volumes --batch 16 --crop 128 --flicker 1 \
    --even 4 --clean 0.1 --reset 0.07 --light 0.5 0.5 --false-motion 0.1 --sparse-planes 0.1 --blend 0.5 \
    --wait 50 --start "${checkpoint:-$published}" >"$work/logs/train.log" 2>&1
wait
"$python" -m training.denoise.checkpoint mix "$work/run/checkpoint.pt:$share" \
    "$published:$("$python" -c "print(1 - $share)")" --newer "$newer" -o "$work/$network.1x.pt"

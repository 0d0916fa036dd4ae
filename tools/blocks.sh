#!/usr/bin/env bash
# What a scene loses by being trained in blocks: it is trained whole, and in 2x1 blocks that are merged, and both splats are
# compared with the photos that neither has seen.
#
#   tools/blocks.sh GENESPLAT SCENE FOLDER [OPTION OF TRAIN]...
#
# FOLDER must not be there yet. Sizes of photos are asked for by --max-side PX, first among the options.
set -euo pipefail

genesplat=$1 scene=$2 folder=$3
shift 3
size=()
[ "${1:-}" = --max-side ] && size=("$1" "$2")

score() {
    "$genesplat" evaluate "$1" --data "$scene" "${size[@]}" --no-lpips --json "$2" >&2
    awk -F '[:,]' '/"psnr"/ { print $2; exit }' "$2"
}

mkdir "$folder"
"$genesplat" split "$scene" --blocks 2x1 --out "$folder/blocks" >&2
"$genesplat" train "$scene" --out "$folder/whole" --no-lpips "$@" >&2
for block in "$folder"/blocks/scenes/*; do
    held_out=(--train-on-all)
    [ -e "$block/test.txt" ] && held_out=(--test-list "$block/test.txt")
    "$genesplat" train "$block" "${held_out[@]}" --out "$folder/blocks/runs/$(basename "$block")" --no-lpips "$@" >&2
done
"$genesplat" merge "$folder/blocks" --out "$folder/merged.ply" >&2

whole=$(score "$folder/whole" "$folder/whole.json")
merged=$(score "$folder/merged.ply" "$folder/merged.json")
awk -v whole="$whole" -v merged="$merged" \
    'BEGIN { printf "whole %.2f dB, merged %.2f dB, difference %+.2f dB\n", whole, merged, merged - whole }'

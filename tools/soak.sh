#!/usr/bin/env bash
# A soak: one process trains small scenes one after another for hours, while its memory, threads and open files are
# written down. An experiment is used, since it loads, grows, evolves, scores and reports many runs in one process: what
# each run would leak adds up.
#
#   tools/soak.sh GENESPLAT-LAB SECONDS FOLDER [EVERY]
#
# FOLDER/soak.csv gets a line every EVERY seconds (30). Status 0: flat. Status 1: something grew, or the process failed.
set -euo pipefail

binary=$1 seconds=$2 folder=$3 every=${4:-30}
csv=$folder/soak.csv
mkdir -p "$folder"

# More seeds than any soak comes to: it is stopped by the clock.
cat >"$folder/soak.toml" <<TOML
title = "Soak"
scenes = ["gallery"]
methods = ["genesplat", "mip-splatting", "mcmc"]
seeds = [$(seq -s, 0 1999)]
search = ["off"]

[gallery]
width = 128
height = 86
views = 24
points = 1500

[config]
iterations = 1500
max_gaussians = 6000
TOML

"$binary" experiment "$folder/soak.toml" --out "$folder/runs" --device cpu --threads 1 --no-lpips \
    >"$folder/stdout" 2>"$folder/stderr" &
process=$!
trap 'kill "$process" 2>/dev/null || true' EXIT

# Kilobytes, threads, open files and runs that have come to their end; fails once the process is gone.
sample() {
    local status files runs
    status=$(cat "/proc/$process/status") && files=$(ls "/proc/$process/fd" | wc -l)
    runs=$(find "$folder/runs" -name metrics.json 2>/dev/null | wc -l)
    awk -v files="$files" -v runs="$runs" '/^VmRSS:/ { rss = $2 } /^Threads:/ { threads = $2 }
        END { if (rss == "") exit 1; print rss "," threads "," files "," runs }' <<<"$status"
}

echo "seconds,rss_kib,threads,open_files,runs" >"$csv"
began=$SECONDS
while ((SECONDS - began < seconds)); do
    sleep "$every"
    line=$(sample) || { echo "the process ended after $((SECONDS - began)) s:" >&2; tail -n 3 "$folder/stderr" >&2; exit 1; }
    echo "$((SECONDS - began)),$line" >>"$csv"
done
kill -TERM "$process"
status=0
wait "$process" || status=$?
trap - EXIT
if ((status != 130)); then
    echo "status $status instead of 130 after SIGTERM:" >&2
    tail -n 3 "$folder/stderr" >&2
    exit 1
fi

# The first quarter warms up. Peaks are compared, since a run's memory grows with its cloud and is then given back.
awk -F, -v seconds="$seconds" '
    NR == 1 { next }
    { part = int(4 * $1 / seconds); part = part > 3 ? 3 : part; runs = $5 }
    { for (i = 2; i <= 4; i++) if ($i > peak[part, i]) peak[part, i] = $i }
    END {
        split("- rss_kib threads open_files", name, " ")
        for (i = 2; i <= 4; i++) {
            before = peak[1, i]; after = peak[3, i]
            if (before == "" || after == "") { print "too few samples to judge " name[i]; grew = 1; continue }
            verdict = after > before * (i == 2 ? 1.05 : 1) ? "GREW" : "flat"
            if (verdict == "GREW") grew = 1
            printf "%-10s  second quarter %d  last quarter %d  %s\n", name[i], before, after, verdict
        }
        printf "%d runs in %d s\n", runs, seconds
        exit grew
    }' "$csv"

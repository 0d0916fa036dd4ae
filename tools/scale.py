"""How fast many processes train one scene: measures it here, and computes it for machines that are not at hand.

    python tools/scale.py measure GENESPLAT FOX FOLDER     # lab/results/scale.json; an idle machine; needs mpirun
    python tools/scale.py tables                           # the tables of lab/scale.md, from that file
    python tools/scale.py check                            # fails where that page has others

GENESPLAT is built with --features mpi, FOX is shared/data/fox; numpy is needed. A rank has one thread; one process with
two is measured beside two ranks. No number is fitted to runs of three and four ranks: they check the model.
"""

import json
import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "lab/results/scale.json"
PAGE = ROOT / "lab/scale.md"

# Gaussians, longest side of the photos (px), photos a step, iterations.
WORKLOADS = [
    (15_000, 240, 1, 100),
    (60_000, 480, 1, 60),
    (60_000, 480, 4, 60),
    (60_000, 960, 1, 30),
    (240_000, 480, 1, 40),
    (240_000, 480, 4, 40),
    (1_000_000, 400, 1, 12),
]
RANKS = [1, 2, 3, 4]
REPEATS = 2  # the faster counts: what else a machine does only adds

TILE = 16  # px
SPLAT = 48  # bytes of a splat on its way
ROW = 40  # bytes of a sum of gradients on its way back, and of its count
HALO = 2 * 10 * 12  # bytes a column and border: ten rows of pixels there and ten back, three floats a pixel
EXCHANGES = 3  # of a step

# Bytes of memory.
TRAINED = 59 * 4 * 3 + 20  # a row: parameters, two moments, sums
DECIDED = 60  # a row of the whole cloud, on every rank: columns that density control decides by
COPIED = 59 * 4 * 3  # a row, while a checkpoint is written
DRAWN = 150, 60  # a splat and an intersection of the own band


# --- measuring ---------------------------------------------------------------------------------------------------------------


def repeated(fox, folder, gaussians):
    """Fox with each point repeated, and moved by up to 0.02 units, until there are so many."""
    if folder.exists():
        return
    (folder / "sparse/0").mkdir(parents=True)
    shutil.copytree(fox / "images", folder / "images")
    for name in ["cameras.bin", "images.bin"]:
        shutil.copy(fox / "sparse/0" / name, folder / "sparse/0")
    data, points, at = (fox / "sparse/0/points3D.bin").read_bytes(), [], 8
    while at < len(data):
        points.append(data[at + 8 : at + 35])  # position, colour
        at += 51 + 8 * struct.unpack_from("<Q", data, at + 43)[0]
    rng = np.random.default_rng(0)
    with open(folder / "sparse/0/points3D.bin", "wb") as out:
        out.write(struct.pack("<Q", gaussians))
        for index in range(gaussians):
            point = points[index % len(points)]
            place = np.array(struct.unpack_from("<3d", point)) + rng.uniform(-0.02, 0.02, 3)
            out.write(struct.pack("<Q3d", index + 1, *place) + point[24:27] + struct.pack("<dQ", 0.5, 0))


def run(genesplat, scene, out, ranks, side, views, iterations, threads=1):
    """One run: seconds a photo, MB a step, and what its photos show."""
    if not (out / "metrics.json").exists():
        options = f"--iterations {iterations} --max-side {side} --views-per-step {views} --method 3dgs --checkpoint-every 0"
        command = [str(genesplat), "train", str(scene), "--out", str(out), "--threads", str(threads), *options.split()]
        command += ["--device", "cpu", "--seed", "0", "--train-on-all", "--no-lpips"]
        if ranks > 1:
            start = ["mpirun", "-n", str(ranks), "--bind-to", "none", "--oversubscribe"]
            command = start + ["--allow-run-as-root"] * (os.geteuid() == 0) + command
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
        (out / "output.txt").write_text(done.stdout + done.stderr)
    seconds = json.loads((out / "metrics.json").read_text())["seconds"]["gradient"]
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    steps = [line for line in lines if line["event"] == "step"]
    sent = re.search(r"([\d.]+) MB a step", (out / "output.txt").read_text())
    mean = lambda name: float(np.mean([step[name] for step in steps]))
    return {
        "ranks": ranks,
        "seconds": seconds / iterations,
        "megabytes": float(sent[1]) if sent else 0.0,
        "gaussians": mean("gaussians"),
        "visible": mean("visible"),
        "intersections": mean("intersections"),
    }


def stages(genesplat, fox, folder):
    """What `bench step` says of a Gaussian, an intersection and a pixel, with all degrees of colour: seconds of one thread."""
    out = folder / "stages.json"
    command = [str(genesplat.with_name("genesplat-lab")), "bench", "step", "--data", str(fox), "--max-side", "480", "--gaussians", "240000"]
    subprocess.run([*command, "--threads", "1", "--device", "cpu", "--json", str(out)], check=True, capture_output=True)
    figures = json.loads(out.read_text())
    seconds = lambda *names: 1e-3 * sum(figures["stages"][name] for name in names)
    return [
        seconds("project", "update") / figures["gaussians"],
        seconds("bin", "rasterise", "rasterise_backward") / figures["tile_splats"],
        seconds("loss") / (figures["width"] * figures["height"]),
    ]


def processor():
    """Its name, and the widest vectors that kernels may use."""
    text = Path("/proc/cpuinfo").read_text()
    name = re.search(r"model name\s*: (.*)", text)
    vectors = [word for word, flag in [("AVX-512", "avx512f"), ("AVX2", "avx2")] if flag in text.split()]
    return ", ".join([name[1] if name else "an unknown kind", *vectors[:1]])


def measure(genesplat, fox, folder):
    folder.mkdir(parents=True, exist_ok=True)
    runs, together, alone = [], [], stages(genesplat, fox, folder)
    for gaussians, side, views, iterations in WORKLOADS:
        scene = folder / f"scene-{gaussians}"
        repeated(fox, scene, gaussians)
        size = {"side": side, "width": round(side * 9 / 16), "height": side, "views": views}
        for found, ranks, threads in [(together, 1, 2)] + [(runs, ranks, 1) for ranks in RANKS]:
            out = [folder / f"run-{gaussians}-{side}-{views}-{ranks}-{threads}-{nth}" for nth in range(REPEATS)]
            all_runs = [run(genesplat, scene, each, ranks, side, views, iterations, threads) for each in out]
            found.append(size | min(all_runs, key=lambda each: each["seconds"]))
            print(found[-1], flush=True)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    cores = len(os.sched_getaffinity(0))
    figures = {"commit": commit, "cores": cores, "machine": f"{cores} cores of {processor()}", "stages": alone, "runs": runs, "two_threads": together}
    FIGURES.write_text(json.dumps(figures, indent=1) + "\n")


# --- the model ---------------------------------------------------------------------------------------------------------------


def work(load):
    """What a photo costs, in units that are fitted: Gaussians, intersections, pixels."""
    return [load["gaussians"], load["intersections"], load["width"] * load["height"]]


def drawers(load, ranks):
    """How many ranks draw one photo: a step of several photos deals them out."""
    return ranks / min(load["views"], ranks)


def crossings(load, borders):
    """How many of the borders between bands a splat meets: it has about as many rows of tiles as columns."""
    rows = np.sqrt(load["intersections"] / max(load["visible"], 1.0))
    return rows * borders / max(load["height"] / TILE, 1.0)


def elsewhere(load, ranks, near):
    """The part of the splats that another rank draws. Ranks hold neighbours in space, so with two bands only `near` of what
    chance would send leaves its rank; with more, more."""
    bands = drawers(load, ranks)
    return (1 - 1 / ranks) * (1.0 if bands <= 1 else 1 - (1 - near) * min(2 / bands, 1.0))


def sent(load, ranks, near):
    """Splats that are sent to another rank for one photo, and sums of gradients that come back."""
    part = elsewhere(load, ranks, near)
    crossed = crossings(load, drawers(load, ranks) - 1)
    tiles = load["intersections"] / max(load["visible"], 1.0)
    splats = load["visible"] * part * (1 + crossed)
    return splats, load["visible"] * part * (1 + crossed * max(tiles / 2, 1.0))


def traffic(load, ranks, near):
    """Bytes of one photo between all ranks."""
    splats, rows = sent(load, ranks, near)
    return SPLAT * splats + ROW * rows + HALO * load["width"] * (drawers(load, ranks) - 1)


def imbalance(load, ranks):
    """The slowest band beside the mean: bands are whole rows of tiles, half of one too high."""
    rows, cut = load["height"] / TILE, drawers(load, ranks)
    return 1.0 if cut == 1 else max(1 + 0.5 * cut / rows, cut / rows)


def turns(shared):
    """Times longer with so many ranks on a core, which wait for each other: between sharing it evenly and one after another."""
    return max(1.0, 0.5 * (shared + np.ceil(shared)))


def photo_seconds(load, ranks, unit, cores=None, network=None):
    """Seconds of a photo: on the processor, of bytes, and of waiting for messages. Without a network memory is one."""
    gaussians, intersections, pixels = np.multiply(work(load), unit["work"])
    own = gaussians / ranks + (intersections + pixels) / ranks * imbalance(load, ranks)
    busy = own + unit["sent"] * sent(load, ranks, unit["near"])[0] / ranks
    busy *= turns(ranks / cores) if cores else 1.0
    if ranks == 1:
        return busy, 0.0, 0.0
    exchanges = EXCHANGES / min(load["views"], ranks)
    if network is None:
        return busy, 0.0, exchanges * unit["exchange"]
    bandwidth, latency = network
    # Lengths go to all in a tree; then as many messages as ranks that splats go to.
    partners = min(ranks - 1, drawers(load, ranks) + 2)
    return busy, traffic(load, ranks, unit["near"]) / ranks / bandwidth, exchanges * latency * (np.log2(ranks) + partners)


def fitted(figures):
    """Costs of the units: from runs of one rank, held near those of the stages alone, since Gaussians and intersections grow
    together in these runs; and from runs of two ranks."""
    runs, alone = figures["runs"], np.array(figures["stages"])
    one = [run for run in runs if run["ranks"] == 1]
    rows, seconds = np.array([work(run) for run in one]), np.array([run["seconds"] for run in one])
    held = np.diag(HOLD / alone)
    costs = np.linalg.lstsq(np.vstack([rows / seconds[:, None], held]), np.append(np.ones(len(one)), [HOLD] * 3), rcond=None)[0]
    unit = {"work": costs, "sent": 0.0, "exchange": 0.0, "near": 1.0}
    two = [run for run in runs if run["ranks"] == 2]
    banded = [run for run in two if run["views"] == 1]
    unit["near"] = float(np.median([1e6 * run["megabytes"] / traffic(run, 2, 1.0) for run in banded]))
    left = np.array([run["seconds"] - sum(photo_seconds(run, 2, unit)) for run in two])
    columns = np.array([[sent(run, 2, unit["near"])[0] / 2, EXCHANGES / min(run["views"], 2)] for run in two])
    scale = np.array([run["seconds"] for run in two])
    unit["sent"], unit["exchange"] = nonnegative(columns / scale[:, None], left / scale)
    return unit


# How much an error of a stage's cost weighs beside one of a run's time.
HOLD = 0.3


def nonnegative(rows, values):
    """Least squares with what would be negative left out."""
    kept = list(range(rows.shape[1]))
    while True:
        found = np.linalg.lstsq(rows[:, kept], values, rcond=None)[0]
        if (found >= 0).all() or len(kept) == 1:
            out = np.zeros(rows.shape[1])
            out[kept] = np.maximum(found, 0)
            return out
        kept.pop(int(np.argmin(found)))


# --- the page ----------------------------------------------------------------------------------------------------------------

NETWORKS = {
    "10 Gb Ethernet": (1.25e9, 30e-6),
    "100 Gb Ethernet (RoCE)": (12.5e9, 5e-6),
    "InfiniBand NDR": (50e9, 2e-6),
}
# A rank of the tables is a socket: so many times as fast as one thread of the machine that was measured.
SOCKET = 24.0
MEMORY = 256e9


def imagined(gaussians, views):
    """A photo of 1920x1080. A view of a million Gaussians shows 437,000 and 3.04 million intersections (counted by an audit of
    the GPU kernels); of more, as many more as the root says, since a larger scene is mostly elsewhere."""
    more = np.sqrt(gaussians / 1e6)
    load = {"gaussians": gaussians, "visible": 437e3 * more, "intersections": 3.04e6 * more}
    return load | {"width": 1920, "height": 1080, "views": views}


def memory(load, ranks):
    """Bytes of the largest rank, photos aside, and what most of them are."""
    gaussians, visible, intersections = load["gaussians"], load["visible"], load["intersections"]
    cut = drawers(load, ranks)
    parts = {
        "rows": TRAINED * gaussians / ranks,
        "columns of density control": DECIDED * gaussians,
        "the copy for a checkpoint": COPIED * gaussians / ranks,
        "the band": (DRAWN[0] * visible + DRAWN[1] * intersections) / cut,
    }
    return sum(parts.values()), max(parts, key=parts.get)


def in_units(seconds):
    return f"{1e3 * seconds:,.1f} ms" if seconds < 1 else f"{seconds:,.2f} s"


def checked(figures, unit):
    lines = [f"Commit `{figures['commit']}`, {figures['machine']}, idle:", ""]
    lines += ["| Gaussians | side, px | photos a step | ranks | measured | model | ratio | MB a photo | model |"]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    for run in figures["runs"]:
        ranks = run["ranks"]
        model = sum(photo_seconds(run, ranks, unit, figures["cores"]))
        shown = [f"{run['gaussians']:,.0f}", run["side"], run["views"], ranks, in_units(run["seconds"]), in_units(model)]
        shown += [f"{model / run['seconds']:.2f}"]
        sizes = [f"{run['megabytes']:.2f}", f"{1e-6 * traffic(run, ranks, unit['near']):.2f}"] if ranks > 1 else ["", ""]
        lines.append("| " + " | ".join(map(str, shown + sizes)) + " |")
    return lines


def beside_threads(figures):
    lines = ["| Gaussians | side, px | photos a step | two threads | two ranks | speed |", "|---|---|---|---|---|---|"]
    two_ranks = [run for run in figures["runs"] if run["ranks"] == 2]
    for one, two in zip(figures["two_threads"], two_ranks, strict=True):
        seconds = [one["seconds"], two["seconds"]]
        shown = [f"{two['gaussians']:,.0f}", two["side"], two["views"], *map(in_units, seconds), f"{seconds[0] / seconds[1]:.2f}"]
        lines.append("| " + " | ".join(map(str, shown)) + " |")
    return lines


def units(unit):
    names = ["a Gaussian (projected, stepped)", "an intersection", "a pixel"]
    lines = ["| what | one thread |", "|---|---|"]
    lines += [f"| {name} | {1e9 * cost:.0f} ns |" for name, cost in zip(names, unit["work"])]
    lines += [f"| a splat sent to another rank, and its sums back | {1e9 * unit['sent']:.0f} ns |"]
    lines += [f"| an exchange within this machine | {1e6 * unit['exchange']:.0f} µs |"]
    return lines + [f"| splats that leave their rank with two bands, of those that would by chance | {100 * unit['near']:.0f} % |"]


def speeds(unit):
    """Photos a second, and what takes most of the time: work, bytes, messages."""
    ranks = [1, 4, 16, 64, 256, 1024]
    lines = ["| network | Gaussians | photos a step | " + " | ".join(f"{n}" for n in ranks) + " |"]
    lines += ["|---|---|---|" + "---|" * len(ranks)]
    unit = unit | {"work": unit["work"] / SOCKET, "sent": unit["sent"] / SOCKET}
    for name, network in NETWORKS.items():
        for gaussians in [1e6, 1e7, 1e8, 1e9]:
            for views in [1, 16, 64]:
                load, cells = imagined(gaussians, views), []
                for n in ranks:
                    parts = photo_seconds(load, n, unit, network=network)
                    bound = "wbm"[int(np.argmax(parts))]
                    fits = memory(load, n)[0] <= MEMORY
                    cells.append(f"{1 / sum(parts):,.0f} {bound}" if fits else "-")
                lines.append(f"| {name} | {gaussians / 1e6:,.0f} M | {views} | " + " | ".join(cells) + " |")
    return lines


def memories():
    ranks = [1, 4, 16, 64, 256, 1024]
    lines = ["| Gaussians | " + " | ".join(f"{n}" for n in ranks) + " | most of it at 1024 |", "|---|" + "---|" * (len(ranks) + 1)]
    for gaussians in [1e6, 1e7, 1e8, 1e9]:
        load = imagined(gaussians, 1)
        cells = [f"{1e-9 * memory(load, n)[0]:,.1f}" for n in ranks]
        lines.append(f"| {gaussians / 1e6:,.0f} M | " + " | ".join(cells) + f" | {memory(load, 1024)[1]} |")
    return lines


def tables(check=False):
    figures = json.loads(FIGURES.read_text())
    unit, page = fitted(figures), PAGE.read_text()
    old = page
    made = {"checked": checked(figures, unit), "units": units(unit), "speeds": speeds(unit), "memory": memories()}
    made["beside threads"] = beside_threads(figures)
    for name, lines in made.items():
        begin, end = f"<!-- scale: {name} -->", "<!-- /scale -->"
        before, rest = page.split(begin, 1)
        page = before + begin + "\n" + "\n".join(lines) + "\n" + end + rest.split(end, 1)[1]
    if check and page != old:
        sys.exit(f"{PAGE} is not what {FIGURES} says: python tools/scale.py tables")
    PAGE.write_text(page)
    ratios = [sum(photo_seconds(run, run["ranks"], unit, figures["cores"])) / run["seconds"] for run in figures["runs"]]
    print(f"model / measured: {min(ratios):.2f} to {max(ratios):.2f}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure", *paths] if len(paths) == 3:
            measure(*(Path(path).resolve() for path in paths))
        case ["tables" | "check" as verb]:
            tables(verb == "check")
        case _:
            sys.exit(__doc__)

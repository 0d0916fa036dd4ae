"""NVIDIA's machine code of a kernel, from naga's HLSL, without a card or a driver.

HLSL -> CUDA (slangc) -> PTX (nvcc) -> machine code (ptxas), which nvdisasm prints. The driver's own compiler starts from
SPIR-V and is not to be had by itself; this is its sibling, from the same optimiser. All tools are PyPI wheels.
"""

import math
import re
import subprocess
from pathlib import Path

WHEELS = [
    "slangtorch==1.3.22",
    "triton==3.3.1",
    *(f"nvidia-{part}==13.0.*" for part in ("cuda-nvcc", "nvvm", "cuda-crt", "cuda-runtime", "cuda-cccl")),
]
# What a multiprocessor has: warps, workgroups, bytes of shared memory, of which each workgroup loses one KiB.
MULTIPROCESSORS = {"sm_90": (64, 32, 228 << 10), "sm_89": (48, 24, 100 << 10)}
REGISTERS = 65536


def as_for_loops(hlsl: str) -> str:
    """naga's HLSL runs a loop's step at the head of its body, behind a flag; its SPIR-V has it where it belongs."""
    loop = re.compile(
        r"bool (loop_init\w*) = true;\n\s*while\(true\) \{\n"
        r"((?:\s*if \(all\(loop_bound.*\n\s*loop_bound\w* -= .*\n)?)"
        r"\s*if \(!\1\) \{\n\s*uint (\w+) = (\w+);\n\s*\4 = \((\3 [^;]+)\);\n\s*\}\n\s*\1 = false;\n"
    )

    def written_as_for(match: re.Match) -> str:
        _, guard, copy, variable, step = match.groups()
        return f"for (;; {variable} = ({step.replace(copy, variable, 1)})) {{\n{guard}"

    return loop.sub(written_as_for, hlsl)


def cuda_of(hlsl: Path, packages: Path) -> Path:
    """The kernel in CUDA."""
    text = as_for_loops(hlsl.read_text())
    constant_array = r"(static const float \w+\[\d+\] = )Constructarray\d+_float_\((.*)\);"
    text = re.sub(constant_array, r"\1{ \2 };", text)
    source, cuda = hlsl.with_suffix(".for.hlsl"), hlsl.with_suffix(".cu")
    source.write_text(text)
    slangc = [packages / "slangtorch/bin/slangc", source, "-target", "cuda", "-entry", "main", "-stage", "compute"]
    run([*slangc, "-o", cuda])
    # Slang copies words of a buffer byte by byte; drivers load them.
    text = cuda.read_text()
    text = text.replace(
        "memcpy(&data, ((const char*)this->data) + index, sizeof(T));",
        "data = *(const T*)(((const char*)this->data) + index);",
    ).replace(
        "memcpy((char*)data + index, &value, sizeof(T));",
        "*(T*)((char*)data + index) = value;",
    )
    cuda.write_text(text)
    return cuda


def count(hlsl: Path, packages: Path) -> dict[str, dict[str, int]]:
    """Figures of one kernel for each architecture."""
    toolkit = packages / "nvidia/cu13"
    groups = re.search(r"\[numthreads\((\d+), (\d+), (\d+)\)\]", hlsl.read_text()).groups()
    threads = math.prod(int(side) for side in groups)
    cuda = cuda_of(hlsl, packages)
    ptx = cuda.with_suffix(".ptx")
    nvcc = [toolkit / "bin/nvcc", "-arch=compute_89", "-ptx", "-O3", "--use_fast_math", "-w", f"-I{toolkit}/include"]
    run([*nvcc, cuda, "-o", ptx])
    return {name: assemble(ptx, name, threads, packages) for name in MULTIPROCESSORS}


def assemble(ptx: Path, architecture: str, threads: int, packages: Path) -> dict[str, int]:
    """Figures of one kernel for one architecture."""
    binary = ptx.with_suffix(f".{architecture}.cubin")
    log = run([packages / "nvidia/cu13/bin/ptxas", f"-arch={architecture}", "-v", ptx, "-o", binary])
    sass = run([packages / "triton/backends/nvidia/bin/nvdisasm", "-c", binary])
    binary.with_suffix(".sass").write_text(sass)
    registers = int(re.search(r"Used (\d+) registers", log).group(1))
    shared = re.search(r"(\d+) bytes smem", log)
    shared = int(shared.group(1)) if shared else 0
    instructions, loops = loops_of(sass)
    return {
        "instructions": instructions,
        "hot loop": hot_loop(loops),
        "registers": registers,
        "spilled": int(re.search(r"(\d+) bytes spill stores", log).group(1)),
        "shared": shared,
        "occupancy": occupancy(architecture, threads, registers, shared),
    }


def loops_of(sass: str) -> tuple[int, list[tuple[int, int]]]:
    """Number of instructions, and the first and last instruction of each loop: what a branch goes back over."""
    labels, branches, at = {}, [], 0
    for line in sass.splitlines():
        if label := re.match(r"(\.L\w+):", line):
            labels[label.group(1)] = at
        elif re.match(r"\s+/\*[0-9a-f]{4,}\*/", line) and not re.search(r"\*/\s+NOP\b", line):
            if target := re.search(r"\bBRA[\w.]*\s.*`\((\.L\w+)\)", line):
                branches.append((target.group(1), at))
            at += 1
    # Behind its end a kernel has a branch to itself.
    loops = {}
    for label, last in branches:
        first = labels.get(label, last)
        if first < last:
            loops[first] = max(last, loops.get(first, 0))
    return at, sorted(loops.items())


def hot_loop(loops: list[tuple[int, int]]) -> int:
    """Instructions of the longest loop that has no other loop in it; 0 where there is none."""
    def has_inner(loop: tuple[int, int]) -> bool:
        return any(loop != other and loop[0] <= other[0] and other[1] <= loop[1] for other in loops)

    return max((last - first + 1 for first, last in loops if not has_inner((first, last))), default=0)


def occupancy(architecture: str, threads: int, registers: int, shared: int) -> int:
    """Per cent of a multiprocessor's warps that can be there at once."""
    warps_max, groups_max, shared_bytes = MULTIPROCESSORS[architecture]
    warps = math.ceil(threads / 32)
    # Registers are handed out by 8 a thread, memory by 128 bytes.
    by_registers = REGISTERS // (32 * math.ceil(registers / 8) * 8) // warps
    by_memory = shared_bytes // (1024 + math.ceil(shared / 128) * 128)
    return 100 * warps * min(warps_max // warps, groups_max, by_registers, by_memory) // warps_max


def run(command: list) -> str:
    """Output of a command, which must not fail."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} failed: {(done.stdout + done.stderr).strip()[:2000]}")
    return done.stdout + done.stderr

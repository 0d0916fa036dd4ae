"""AMD's machine code of a kernel, from Mesa's RADV without a card.

With RADV_FORCE_FAMILY the driver compiles for a device that is not there, and prints what it made. It gets naga's
SPIR-V through the PyPI package `vulkan`; wgpu cannot open such a device.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

WHEELS = ["vulkan==1.3.275.1"]
FAMILY = "navi21"
# The version that the table is of: others compile otherwise.
MESA = "22.3.6"
DRIVERS = Path("/usr/share/vulkan/icd.d")
# Names of the figures in the table, and in Mesa's output.
FIGURES = {
    "instructions": "Instructions",
    "registers": "VGPRs",
    "spilled": "Spilled VGPRs",
    "shared": "LDS size",
    "occupancy": "Subgroups per SIMD",
}
# Subgroups that a SIMD of RDNA 2 can hold.
SUBGROUPS_MAX = 16


def driver() -> Path | None:
    """What Debian's mesa-vulkan-drivers installs, if it is there."""
    return next(iter(sorted(DRIVERS.glob("radeon_icd*.json"))), None)


def version() -> str:
    """That of Debian's package; empty where it is not one."""
    query = ["dpkg-query", "--show", "--showformat=${Version}", "mesa-vulkan-drivers"]
    try:
        return subprocess.run(query, capture_output=True, text=True).stdout.partition("-")[0]
    except OSError:
        return ""


def count(kernels: list[Path], packages: Path) -> list[dict[str, int]]:
    """Figures of kernels, from their SPIR-V."""
    environment = os.environ | {
        "RADV_FORCE_FAMILY": FAMILY,
        "RADV_DEBUG": "shaderstats",
        "VK_DRIVER_FILES": str(driver()),
        "VK_ICD_FILENAMES": str(driver()),
        "NODEVICE_SELECT": "1",
        "MESA_SHADER_CACHE_DISABLE": "true",
        "PYTHONPATH": str(packages),
    }
    command = [sys.executable, "-B", __file__, *map(str, kernels)]
    done = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"RADV: {done.stderr.strip()[-2000:]}")
    return [figures(text) for text in done.stderr.split("== kernel\n")[1:]]


def figures(text: str) -> dict[str, int]:
    """Of one kernel, from what Mesa printed."""
    found = {}
    for name, printed in FIGURES.items():
        match = re.search(rf"^{printed}:\s+(\d+)", text, flags=re.MULTILINE | re.IGNORECASE)
        if not match:
            raise RuntimeError(f"RADV prints no {printed}: {text[:2000]}")
        found[name] = int(match.group(1))
    found["occupancy"] = min(100, 100 * found["occupancy"] // SUBGROUPS_MAX)
    return found


def compile_all(kernels: list[str]) -> None:
    """Makes a pipeline of each kernel; the driver prints what it compiled."""
    import vulkan as vk

    application = vk.VkApplicationInfo(apiVersion=vk.VK_MAKE_VERSION(1, 2, 0))
    instance = vk.vkCreateInstance(vk.VkInstanceCreateInfo(pApplicationInfo=application), None)
    physical = vk.vkEnumeratePhysicalDevices(instance)[0]
    queue = vk.VkDeviceQueueCreateInfo(queueFamilyIndex=0, queueCount=1, pQueuePriorities=[1.0])
    features = vk.VkPhysicalDeviceFeatures(robustBufferAccess=True)
    description = vk.VkDeviceCreateInfo(pQueueCreateInfos=[queue], pEnabledFeatures=features)
    device = vk.vkCreateDevice(physical, description, None)
    for kernel in kernels:
        print("== kernel", file=sys.stderr, flush=True)
        code = Path(kernel).read_bytes()
        module = vk.vkCreateShaderModule(device, vk.VkShaderModuleCreateInfo(codeSize=len(code), pCode=code), None)
        stage = vk.VkPipelineShaderStageCreateInfo(stage=vk.VK_SHADER_STAGE_COMPUTE_BIT, module=module, pName="main")
        layout = layout_of(vk, device, Path(kernel).with_suffix(".hlsl").read_text())
        pipeline = vk.VkComputePipelineCreateInfo(stage=stage, layout=layout)
        vk.vkCreateComputePipelines(device, vk.VK_NULL_HANDLE, 1, [pipeline], None)
    # Closing a device that is not there may fail.
    os._exit(0)


def layout_of(vk, device, hlsl: str):
    """The bindings of a kernel, which its HLSL has, too: `b` are uniforms."""
    types = {"b": vk.VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER}
    bindings = [
        vk.VkDescriptorSetLayoutBinding(
            binding=int(number),
            descriptorType=types.get(kind, vk.VK_DESCRIPTOR_TYPE_STORAGE_BUFFER),
            descriptorCount=1,
            stageFlags=vk.VK_SHADER_STAGE_COMPUTE_BIT,
        )
        for kind, number in re.findall(r"register\(([btu])(\d+)", hlsl)
    ]
    group = vk.vkCreateDescriptorSetLayout(device, vk.VkDescriptorSetLayoutCreateInfo(pBindings=bindings), None)
    return vk.vkCreatePipelineLayout(device, vk.VkPipelineLayoutCreateInfo(pSetLayouts=[group]), None)


if __name__ == "__main__":
    compile_all(sys.argv[1:])

//! Writes what compilers get of every kernel, for those who count instructions (`tools/gpu-count`).
//!
//! `kernel_code FOLDER` writes each kernel as the SPIR-V that Vulkan drivers get, and as HLSL, which names
//! its bindings.

use std::path::Path;

use anyhow::{Context, Result, bail};
use naga::ShaderStage::Compute;
use naga::back::pipeline_constants::process_overrides;
use naga::back::{PipelineConstants, hlsl, spv};
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder] = &arguments[..] else { bail!("usage: kernel_code FOLDER") };
    std::fs::create_dir_all(folder)?;
    genesplat_gpu::kernel_sources().try_for_each(|(kernel, source)| {
        write_kernel(Path::new(folder), kernel, &source).with_context(|| kernel.to_owned())
    })
}

/// Values of the constants that the backend sets when it makes a pipeline: those of a step where there are
/// several.
fn overrides(kernel: &str) -> Vec<(&'static str, f64)> {
    match kernel.rsplit('/').next().unwrap_or_default() {
        "plan_lists" => vec![("LIST_MAX", 32_768.0)],
        "sort_lists" => vec![("GROUPS_EACH", 0.0)],
        "merge_lists" => vec![("RUN", 1_024.0), ("GROUPS_EACH", 0.0)],
        "loss" => vec![("FORWARD_ONLY", 0.0)],
        "gather" => vec![("VECTORS", 12.0), ("FRESH", 1.0)],
        "average" => vec![("VECTORS", 12.0)],
        "adam_geometry" => vec![("ALL_ROWS", 0.0)],
        "keep_geometry" => vec![("TAKE", 1.0)],
        _ => Vec::new(),
    }
}

fn write_kernel(folder: &Path, kernel: &str, source: &str) -> Result<()> {
    let module = naga::front::wgsl::parse_str(source)?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module)?;
    let constants: PipelineConstants =
        overrides(kernel).into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    let (module, info) = process_overrides(&module, &info, Some((Compute, "main")), &constants)?;
    let path = folder.join(kernel.replace('/', "."));
    std::fs::write(path.with_added_extension("hlsl"), hlsl_of(&module, &info)?)?;
    let words = spirv_of(&module, &info)?;
    let bytes: Vec<u8> = words.into_iter().flat_map(u32::to_le_bytes).collect();
    Ok(std::fs::write(path.with_added_extension("spv"), bytes)?)
}

fn hlsl_of(module: &naga::Module, info: &ModuleInfo) -> Result<String> {
    let options = hlsl::Options {
        shader_model: hlsl::ShaderModel::V6_0,
        fake_missing_bindings: true,
        zero_initialize_workgroup_memory: false,
        ..Default::default()
    };
    let entry = hlsl::PipelineOptions { entry_point: Some((Compute, "main".to_owned())) };
    let mut text = String::new();
    hlsl::Writer::new(&mut text, &options, &entry).write(module, info, None)?;
    Ok(text)
}

/// As wgpu asks for it where the driver checks buffers itself (`robustBufferAccess2`).
fn spirv_of(module: &naga::Module, info: &ModuleInfo) -> Result<Vec<u32>> {
    let unchecked = BoundsCheckPolicy::Unchecked;
    let options = spv::Options {
        lang_version: (1, 3),
        flags: spv::WriterFlags::empty(),
        bounds_check_policies: BoundsCheckPolicies {
            index: BoundsCheckPolicy::Restrict,
            buffer: unchecked,
            image_load: unchecked,
            binding_array: unchecked,
        },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: true,
        ..Default::default()
    };
    let entry = spv::PipelineOptions { shader_stage: Compute, entry_point: "main".to_owned() };
    Ok(spv::write_vec(module, info, &options, Some(&entry))?)
}

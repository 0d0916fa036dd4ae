//! genesplat reconstructs a scene from photos as 3D Gaussians, and evolves them.
//!
//! This crate is the door to the library: it re-exports the crates that do the work, under the names below.
//! The [`command`] is built on nothing else.
//!
//! | module | what it is |
//! |---|---|
//! | [`core`] | clouds, cameras, pictures, randomness, and the traits of a device |
//! | [`io`] | scenes in, splats out |
//! | [`gallery`] | the bundled scene, and the ray caster that photographs it |
//! | [`gpu`] | the same stages as WGSL kernels: the backend for graphics cards |
//! | [`cluster`] | a cloud over many processes: the CPU backend, dealt out to ranks |
//! | [`kernels`] | the numeric stages: the f64 reference and the CPU backend |
//! | [`evolve`] | the genetic algorithm, without a renderer |
//! | [`train`] | the training algorithm: methods, density control, the search |
//! | [`viewer`] | the live page: a small server on loopback, and what it shows |
//! | [`metrics`] | PSNR, SSIM and LPIPS, of two pictures and of all test photos |
//! | [`run`] | a run: settings, its folder, training into it, figures and pages |
//! | [`poses`] | cameras of photos without any |
//! | [`command`] | the whole command, for who starts it from elsewhere: the wheel of Python does |
//! | [`terminal`], [`flags`] | what the programs of this workspace share; not meant for others |
//!
//! From photos to figures, here with the bundled scene (made tiny, and trained for a moment):
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//!
//! use genesplat::gallery::{self, GalleryOptions};
//! use genesplat::io::HoldOut;
//! use genesplat::kernels::cpu::CpuBackend;
//! use genesplat::metrics::evaluate;
//! use genesplat::train::{Silent, Start, TrainConfig, train};
//!
//! let options = GalleryOptions { width: 48, height: 32, views: 9, points: 200, seed: 1 };
//! let scene = gallery::generate(&options).into_scene(HoldOut::EveryEighth);
//! let points = scene.points.iter().map(|point| (point.position, point.rgb)).collect();
//!
//! let config = TrainConfig { seed: 1, iterations: 40, ..TrainConfig::default() }.resolve()?;
//! let mut backend = CpuBackend::new();
//! let stop = AtomicBool::new(false);
//! let outcome = train(&mut backend, &scene.train, Start::Points(points), &config, &mut Silent, &stop)?;
//!
//! let scores = evaluate(&mut backend, &scene.test, &config.render_settings(), None, |_view, _render| {})?;
//! println!("{} Gaussians, {:.1} dB on photos that training never saw", outcome.cloud.len(), scores.psnr);
//! # assert!(scores.psnr > 12.0, "{}", scores.psnr);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Commands name what they use as who uses this library does.
extern crate self as genesplat;

pub use genesplat_cluster as cluster;
pub use genesplat_core as core;
pub use genesplat_evolve as evolve;
pub use genesplat_gallery as gallery;
pub use genesplat_gpu as gpu;
pub use genesplat_io as io;
pub use genesplat_kernels as kernels;
pub use genesplat_metrics as metrics;
pub use genesplat_run as run;
pub use genesplat_train as train;
pub use genesplat_viewer as viewer;

mod args;
mod blocks;
pub mod command;
mod commands;
pub mod flags;
mod inspect;
pub mod poses;
mod programs;
mod sharpness;
pub mod terminal;
mod unpacked;

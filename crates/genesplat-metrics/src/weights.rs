//! Weights of networks, as named tensors: safetensors (read and written), and what `torch.save` writes
//! (read).
//!
//! `pytorch-reader` knows all three containers of PyTorch and runs no code that a file may hold. Tensors come
//! out as f32, row-major, under torchvision's names.

use std::collections::BTreeMap;
use std::fmt::{Debug, Display};
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use genesplat_io::{input, shown};
use half::f16;
use pytorch_reader::PytorchReader;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use sha2::{Digest, Sha256};

/// An array of any number of dimensions, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensor {
    /// Length of each dimension, the slowest first; their product is the number of `values`.
    pub shape: Vec<usize>,
    /// The values, the last dimension's side by side.
    pub values: Vec<f32>,
}

/// Tensors in order of their names.
pub type NamedTensors = BTreeMap<String, Tensor>;

/// Why weights could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightFileError {
    /// The operating system refused to read.
    #[error("cannot read the weights {}: {source}", shown(.path))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a file of weights, a damaged one, or one of numbers of another kind.
    #[error("{} {problem}", shown(.path))]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        problem: String,
    },
}

/// Largest safetensors file that is read at once, bytes: four times VGG16's convolutions and classifier in
/// f16.
const BYTES_MAX: u64 = 1 << 30;

/// The tensors in the file at `path` whose name `wants` accepts; the kind of file is told by its content.
///
/// The heads of LPIPS are called `linK.model.1.weight` by their authors, and `linK.weight` here.
pub fn read_weights(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    // Safetensors begin with the length of a header (8 bytes), and the header is a JSON object.
    let mut start = Vec::new();
    let opened = input::open(path).and_then(|file| file.take(9).read_to_end(&mut start));
    opened.map_err(|source| unreadable(path, source))?;
    if start.get(8) == Some(&b'{') { read_safetensors(path, wants) } else { read_pytorch(path, wants) }
}

/// The bytes of a safetensors file that holds `tensors` in f32.
///
/// # Panics
/// When a tensor has not as many values as its shape says.
pub fn to_safetensors(tensors: &NamedTensors) -> Vec<u8> {
    let bytes = |tensor: &Tensor| tensor.values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let all_bytes: Vec<Vec<u8>> = tensors.values().map(bytes).collect();
    let views = tensors.iter().zip(&all_bytes).map(|((name, tensor), bytes)| {
        let view = TensorView::new(Dtype::F32, tensor.shape.clone(), bytes);
        (name, view.expect("a tensor has as many values as its shape says"))
    });
    safetensors::serialize(views, None).expect("views of whole tensors fit a file")
}

/// The SHA-256 sum of the file at `path`, as 64 hexadecimal digits.
pub fn sha256(path: &Path) -> Result<String, WeightFileError> {
    let mut digest = Sha256::new();
    let mut chunk = vec![0; 1 << 20];
    let mut file = input::open(path).map_err(|source| unreadable(path, source))?;
    loop {
        match file.read(&mut chunk).map_err(|source| unreadable(path, source))? {
            0 => return Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()),
            length => digest.update(&chunk[..length]),
        }
    }
}

fn read_safetensors(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    let read = |source| unreadable(path, source);
    let length = fs::metadata(path).map_err(read)?.len();
    if length > BYTES_MAX {
        return Err(damaged(path, format!("it has {length} bytes, and at most {BYTES_MAX} are read")));
    }
    let bytes = input::read(path).map_err(read)?;
    let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(path, error))?;
    let wanted = file.iter().map(|(name, view)| (canonical(name), view)).filter(|(name, _)| wants(name));
    wanted.map(|(name, view)| tensor(path, name, view.dtype(), view.shape(), view.data())).collect()
}

fn read_pytorch(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    let held = fs::metadata(path).map_err(|source| unreadable(path, source))?.len();
    let file = PytorchReader::new(path).map_err(|error| damaged(path, error))?;
    let wanted = file.tensors().iter().map(|(name, tensor)| (canonical(name), tensor));
    let read = |(name, stored): (String, &pytorch_reader::Tensor)| {
        // A tensor may repeat a stored value as often as it says.
        let promised = stored.byte_len() as u64;
        if promised > held {
            return Err(damaged(
                path,
                format!("tensor {} has {promised} bytes, and the file {held}", shown(&name)),
            ));
        }
        let bytes = stored.read().map_err(|error| damaged(path, error))?;
        tensor(path, name, stored.dtype(), stored.shape(), &bytes)
    };
    wanted.filter(|(name, _)| wants(name)).map(read).collect()
}

/// A tensor from little-endian `bytes`. Both libraries call their element types by the same names.
fn tensor(
    path: &Path,
    name: String,
    element: impl Debug,
    shape: &[usize],
    bytes: &[u8],
) -> Result<(String, Tensor), WeightFileError> {
    let values = match format!("{element:?}").as_str() {
        "F32" => bytes.as_chunks().0.iter().map(|&value| f32::from_le_bytes(value)).collect(),
        "F16" => bytes.as_chunks().0.iter().map(|&value| f16::from_le_bytes(value).to_f32()).collect(),
        other => {
            let remedy = "and only F16 and F32 are read; convert the file to F32";
            return Err(unusable(
                path,
                format!("cannot be used: its tensor {} holds {other}, {remedy}", shown(&name)),
            ));
        }
    };
    Ok((name, Tensor { shape: shape.to_vec(), values }))
}

/// The name as torchvision would write it.
fn canonical(name: &str) -> String {
    name.replace(".model.1.", ".")
}

fn unreadable(path: &Path, source: io::Error) -> WeightFileError {
    WeightFileError::Read { path: path.to_owned(), source }
}

fn damaged(path: &Path, reason: impl Display) -> WeightFileError {
    let remedy = "download or copy it again";
    unusable(path, format!("is no whole safetensors or PyTorch file of weights ({reason}); {remedy}"))
}

fn unusable(path: &Path, problem: String) -> WeightFileError {
    WeightFileError::Unusable { path: path.to_owned(), problem }
}

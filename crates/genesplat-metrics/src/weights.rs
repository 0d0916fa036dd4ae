//! Weights of networks, as named tensors: safetensors (read and written), and what `torch.save` writes (read).
//!
//! PyTorch files come in three containers over the years (zip, a stream of pickles, tar), and torchvision still serves
//! the old ones; `pytorch-reader` knows them all and runs no code that a file may hold. Whatever the file says, its
//! tensors come out as f32, row-major, under torchvision's names.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use half::f16;
use pytorch_reader::{DType, PytorchReader};
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
    #[error("cannot read the weights {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a file of weights, or a damaged one.
    #[error(
        "{path} is no whole safetensors or PyTorch file of weights ({reason}); download or copy it again"
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Numbers of another kind.
    #[error(
        "{path}: the tensor {tensor} holds {found}, and only F16 and F32 are read; convert the file to F32"
    )]
    ElementType {
        /// The file.
        path: PathBuf,
        /// Which tensor.
        tensor: String,
        /// The type of its values.
        found: String,
    },
}

/// Largest safetensors file that is read at once, bytes: four times VGG16's convolutions and classifier in f16.
const BYTES_MAX: u64 = 1 << 30;

/// The tensors in the file at `path` whose name `wants` accepts; the others (a classifier, say) are not kept.
///
/// The kind of file is told by its content. The heads of LPIPS are called `linK.model.1.weight` by their authors, and
/// `linK.weight` here.
pub fn read_weights(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    let is_safetensors = starts_like_safetensors(path).map_err(|source| unreadable(path, source))?;
    if is_safetensors { read_safetensors(path, wants) } else { read_pytorch(path, wants) }
}

/// The bytes of a safetensors file that holds `tensors` in f32.
///
/// # Panics
/// When a tensor has not as many values as its shape says.
pub fn to_safetensors(tensors: &NamedTensors) -> Vec<u8> {
    let bytes: BTreeMap<&str, Vec<u8>> =
        tensors.iter().map(|(name, tensor)| (name.as_str(), f32_bytes(&tensor.values))).collect();
    let views = bytes.iter().map(|(&name, bytes)| {
        let view = TensorView::new(Dtype::F32, tensors[name].shape.clone(), bytes);
        (name, view.expect("a tensor has as many values as its shape says"))
    });
    safetensors::serialize(views, None).expect("views of whole tensors fit a file")
}

/// The SHA-256 sum of the file at `path`, as 64 hexadecimal digits.
pub fn sha256(path: &Path) -> Result<String, WeightFileError> {
    let mut digest = Sha256::new();
    let mut chunk = vec![0; 1 << 20];
    let mut file = File::open(path).map_err(|source| unreadable(path, source))?;
    loop {
        match file.read(&mut chunk).map_err(|source| unreadable(path, source))? {
            0 => return Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()),
            length => digest.update(&chunk[..length]),
        }
    }
}

/// Safetensors begin with the length of a header (8 bytes), and the header is a JSON object.
fn starts_like_safetensors(path: &Path) -> io::Result<bool> {
    let mut start = Vec::new();
    File::open(path)?.take(9).read_to_end(&mut start)?;
    Ok(start.get(8) == Some(&b'{'))
}

fn read_safetensors(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    let read = |source| unreadable(path, source);
    let length = fs::metadata(path).map_err(read)?.len();
    if length > BYTES_MAX {
        return Err(damaged(path, format!("it has {length} bytes, and at most {BYTES_MAX} are read")));
    }
    let bytes = fs::read(path).map_err(read)?;
    let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(path, error))?;
    let wanted = file.iter().map(|(name, view)| (canonical(name), view)).filter(|(name, _)| wants(name));
    let tensor = |(name, view): (String, TensorView<'_>)| {
        let values = match view.dtype() {
            Dtype::F32 => from_f32(view.data()),
            Dtype::F16 => from_f16(view.data()),
            other => return Err(element_type(path, &name, other)),
        };
        Ok((name, Tensor { shape: view.shape().to_vec(), values }))
    };
    wanted.map(tensor).collect()
}

fn read_pytorch(path: &Path, wants: impl Fn(&str) -> bool) -> Result<NamedTensors, WeightFileError> {
    let held = fs::metadata(path).map_err(|source| unreadable(path, source))?.len();
    let file = PytorchReader::new(path).map_err(|error| damaged(path, error))?;
    let wanted = file.tensors().iter().map(|(name, tensor)| (canonical(name), tensor));
    let tensor = |(name, stored): (String, &pytorch_reader::Tensor)| {
        let convert = match stored.dtype() {
            DType::F32 => from_f32,
            DType::F16 => from_f16,
            other => return Err(element_type(path, &name, other)),
        };
        // A tensor may repeat a stored value as often as it says.
        let promised = stored.byte_len() as u64;
        if promised > held {
            return Err(damaged(path, format!("tensor {name} has {promised} bytes, and the file {held}")));
        }
        let bytes = stored.read().map_err(|error| damaged(path, error))?;
        Ok((name, Tensor { shape: stored.shape().to_vec(), values: convert(&bytes) }))
    };
    wanted.filter(|(name, _)| wants(name)).map(tensor).collect()
}

/// The name as torchvision would write it.
fn canonical(name: &str) -> String {
    name.replace(".model.1.", ".")
}

fn from_f32(bytes: &[u8]) -> Vec<f32> {
    let (values, _) = bytes.as_chunks::<4>();
    values.iter().map(|&value| f32::from_le_bytes(value)).collect()
}

fn from_f16(bytes: &[u8]) -> Vec<f32> {
    let (values, _) = bytes.as_chunks::<2>();
    values.iter().map(|&value| f16::from_le_bytes(value).to_f32()).collect()
}

fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn unreadable(path: &Path, source: io::Error) -> WeightFileError {
    WeightFileError::Read { path: path.to_owned(), source }
}

fn damaged(path: &Path, reason: impl ToString) -> WeightFileError {
    WeightFileError::Damaged { path: path.to_owned(), reason: reason.to_string() }
}

fn element_type(path: &Path, tensor: &str, found: impl std::fmt::Debug) -> WeightFileError {
    let (tensor, found) = (tensor.to_owned(), format!("{found:?}"));
    WeightFileError::ElementType { path: path.to_owned(), tensor, found }
}

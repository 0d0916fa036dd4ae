//! Weights as `torch.save` wrote them before PyTorch 1.6: torchvision's networks and the heads of LPIPS are
//! such files.

use std::fs;

use genesplat_metrics::weights::{NamedTensors, Tensor, read_weights, sha256, to_safetensors};

/// A pickled text.
fn text(value: &str) -> Vec<u8> {
    [&b"X"[..], &(value.len() as u32).to_le_bytes(), value.as_bytes()].concat()
}

/// A stream of pickles, then the storage: `{name: tensor of shape [1, 3, 1, 1]}` with three values of `class`
/// (`FloatStorage`, say).
fn legacy_file(name: &str, class: &str, values: &[u8]) -> Vec<u8> {
    let pickle = |parts: &[&[u8]]| [&b"\x80\x02"[..], &parts.concat(), b"."].concat();
    let class = format!("ctorch\n{class}\n");
    // ('storage', class, key, location, number of values, no view) is what the tensor refers to.
    let storage =
        [b"(", &text("storage")[..], class.as_bytes(), &text("7"), &text("cpu"), b"K\x03NtQ"].concat();
    let shape_and_stride = b"K\x00(K\x01K\x03K\x01K\x01t(K\x03K\x01K\x01K\x01t\x89";
    let hooks = b"ccollections\nOrderedDict\n)Rt";
    let rebuild =
        [b"ctorch._utils\n_rebuild_tensor_v2\n(", &storage[..], shape_and_stride, hooks, b"R"].concat();
    [
        pickle(&[b"\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19"]),
        pickle(&[b"M\xe9\x03"]),
        pickle(&[b"}(", &text("protocol_version"), b"M\xe9\x03", &text("little_endian"), b"\x88u"]),
        pickle(&[b"}", &text(name), &rebuild, b"s"]),
        pickle(&[b"]", &text("7"), b"a"]),
        3u64.to_le_bytes().to_vec(),
        values.to_vec(),
    ]
    .concat()
}

fn float_file() -> Vec<u8> {
    let values: Vec<u8> = [0.5f32, -2.0, 1e-3].iter().flat_map(|value| value.to_le_bytes()).collect();
    legacy_file("lin0.model.1.weight", "FloatStorage", &values)
}

#[test]
fn heads_are_read_from_torchs_old_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.pth");
    fs::write(&path, float_file()).unwrap();
    let head = Tensor { shape: vec![1, 3, 1, 1], values: vec![0.5, -2.0, 1e-3] };
    assert_eq!(read_weights(&path, |_| true).unwrap(), NamedTensors::from([("lin0.weight".into(), head)]));
    assert_eq!(read_weights(&path, |name| name == "other").unwrap(), NamedTensors::new());

    // 0.5, -2 and 1 in half precision.
    fs::write(&path, legacy_file("x", "HalfStorage", &[0x00, 0x38, 0x00, 0xc0, 0x00, 0x3c])).unwrap();
    assert_eq!(read_weights(&path, |_| true).unwrap()["x"].values, [0.5, -2.0, 1.0]);
    fs::write(&path, legacy_file("x", "LongStorage", &[0; 24])).unwrap();
    let error = read_weights(&path, |_| true).unwrap_err().to_string();
    assert!(error.contains("tensor x holds I64"), "{error}");
}

/// Strides of 0 repeat one stored value as often as the shape says.
#[test]
fn a_tensor_larger_than_its_file_is_never_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.pth");
    let (honest, file) = (b"(K\x01K\x03K\x01K\x01t(K\x03K\x01K\x01K\x01t", float_file());
    let at = file.windows(honest.len()).position(|bytes| bytes == honest).unwrap();
    let boast = b"(K\x01M\xe8\x03K\x01K\x01t(K\x00K\x00K\x00K\x00t";
    fs::write(&path, [&file[..at], boast, &file[at + honest.len()..]].concat()).unwrap();
    let error = read_weights(&path, |_| true).unwrap_err().to_string();
    assert!(error.contains("lin0.weight has 4000 bytes"), "{error}");
}

#[test]
fn weights_cut_anywhere_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights");
    let tensors = [("a".to_owned(), Tensor { shape: vec![2], values: vec![1.0, 2.0] })].into();
    fs::write(&path, to_safetensors(&tensors)).unwrap();
    assert_eq!(read_weights(&path, |_| true).unwrap(), tensors);
    for whole in [fs::read(&path).unwrap(), float_file()] {
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let error =
                read_weights(&path, |_| true).expect_err("truncated weights must not load").to_string();
            assert!(error.contains("no whole") && !error.contains('\n'), "cut to {length}: {error}");
        }
    }
}

#[test]
fn sums_are_sha_256() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("abc");
    fs::write(&path, "abc").unwrap();
    // FIPS 180-2, appendix B.1.
    assert_eq!(sha256(&path).unwrap(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

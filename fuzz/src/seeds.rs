//! The first inputs of every target: small files as genesplat and others write them.

use std::fs;
use std::io;
use std::path::Path;

use genesplat_core::{DeviceState, Gaussians, Moments, Photo, Rng, StateMean, Statistics, Stream};
use genesplat_io::colmap::{ImageRecord, Intrinsics, Model, write_model};
use genesplat_io::format::{Format, Options, SpzVersion};
use genesplat_io::photos::{encode_jpeg, write_png};
use genesplat_io::{Point, bytes};

use genesplat_metrics::weights::{Tensor, to_safetensors};
use genesplat_train::checkpoint::{Cursor, Progress};
use genesplat_train::{Checkpoint, TrainConfig};

use crate::{targets, wrap};

const CAMERAS: &str = "# a comment\n1 PINHOLE 20 16 20 21 10 8\n2 SIMPLE_RADIAL 20 16 20 10 8 0.1\n\
    3 OPENCV 20 16 20 20 10 8 -0.1 0.01 0.001 0\n4 OPENCV_FISHEYE 16 16 9 9 8 8 0.1 0 0 0\n5 FULL_OPENCV 20 16 20 20 10 8 0.1 0 0 0 0 0 0 0\n\
    6 EQUIRECTANGULAR 20 10 20 10\n7 OPENCV_FISHEYE 20 20 6 6 10 10 0.01 0 0 0\n";
const IMAGES: &str = "1 1 0 0 0 0 0 0 1 a.png\n1.5 2.5 -1 3 4 7\n2 0.5 0.5 0.5 0.5 1 2 3 1 b/c d.jpg\n\n";
const FRAMES: &str =
    "# a comment\n1 1 1 0 0 0 0.5 0 1 2 CAMERA 1 1 CAMERA 2 2\n2 1 1 0 0 0 1 0 1 1 IMU 1 3\n";
const POINTS: &str = "7 1.5 -2 3e2 255 0 17 0.5 1 0 2 3\n8 0 0 0 1 2 3 0\n";
const TRANSFORMS: &str = r#"{"camera_model":"OPENCV","fl_x":20,"fl_y":21.5,"cx":10,"cy":8,"w":20,"h":16,"k1":0.1,"k2":0,
"p1":0,"p2":0,"ply_file_path":"a.ply","train_filenames":["a.png"],"test_filenames":["b.png"],"frames":[
{"file_path":"a.png","transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]},
{"file_path":"b.png","mask_path":"m.png","transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]}]}"#;
const BLENDER: &str = r#"{"camera_angle_x":0.69,"w":20.0,"h":16.0,"is_fisheye":false,"frames":[
{"file_path":"./a","transform_matrix":[[0,0,1,1],[0,1,0,2],[1,0,0,3]]}]}"#;
const POINTS_PLY: &str = "ply\nformat ascii 1.0\ncomment c\nelement other 1\nproperty list uchar int i\nelement vertex 2\n\
    property float x\nproperty float y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    end_header\n2 5 6\n1 2 3 4 5 6\n-1e2 .5 7 255 0 1\n";
const POINTS_PLY_BINARY: &[u8] = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
    property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\0\0\x80?\0\0\0\0\0\0\0@abc";
const SPLAT_PLY: &str = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
    property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\nproperty float scale_0\n\
    property float scale_1\nproperty float scale_2\nproperty float rot_0\nproperty float rot_1\nproperty float rot_2\n\
    property float rot_3\nend_header\n1 2 -3e1 .5 0 0 inf -4 -4 -5 1 0 0 0\n0 0 0 0 0 0 -1 -3 -3 -3 1 0.5 0 0\n";
const LOOK: &str = r#"{"type":"look","sequence":7,"pose":{"position":[1,2,3],"rotation":[1,0,0,0],"fov_y":1},
"camera":2,"width":320,"height":200,"quality":70,"render_mode":"depth","error":true}"#;
const REQUEST: &str = "GET /5e1f/main.js HTTP/1.1\r\nHost: localhost:7007\r\nOrigin: http://localhost:7007\r\n\
    Upgrade: websocket\r\n\r\n";
const PATH: &str = r#"{"genesplat_path":1,"views":[{"position":[1,2,3],"rotation":[1,0,0,0],"fov_y":1},
{"position":[1,2,4],"rotation":[0.5,0.5,0.5,0.5],"fov_y":0.5},{"position":[0,2,4],"rotation":[0,1,0,0],"fov_y":2}]}"#;

/// Makes `folder/TARGET/seed-N` for every target.
pub(crate) fn write(folder: &Path) -> io::Result<()> {
    for (target, _) in targets::ALL {
        let seeds = of(target);
        assert!(!seeds.is_empty(), "{target} has seeds");
        fs::create_dir_all(folder.join(target))?;
        for (number, seed) in seeds.iter().enumerate() {
            fs::write(folder.join(target).join(format!("seed-{number}")), seed)?;
        }
    }
    Ok(())
}

fn of(target: &str) -> Vec<Vec<u8>> {
    let splats = |format: Format| vec![splat(format, 3, 3), splat(format, 1, 0)];
    match target {
        "archive" => {
            vec![wrap::zip(
                &["a/1.png", "sparse/0/cameras.txt", "b"],
                &wrap::framed(&[vec![1; 9], CAMERAS.into()]),
            )]
        }
        "archive-names" => vec![b"a/1.png\nb/../2.jpg\nA/1.png".into(), b"1.png\n1.png".into()],
        "cameras-bin" => vec![model("cameras.bin")],
        "images-bin" => vec![model("images.bin")],
        "frames-bin" => vec![frames()],
        "frames-txt" => vec![FRAMES.into()],
        "points-bin" => vec![model("points3D.bin")],
        "cameras-txt" => vec![CAMERAS.into()],
        "lenses" => CAMERAS.lines().skip(2).map(Into::into).collect(),
        "images-txt" => vec![IMAGES.into()],
        "points-txt" => vec![POINTS.into()],
        "transforms" => vec![TRANSFORMS.into(), BLENDER.into()],
        "photos" => photos(),
        "depths" => depths(),
        "points-ply" => vec![POINTS_PLY.into(), POINTS_PLY_BINARY.into()],
        "ply" => [splats(Format::Ply), vec![SPLAT_PLY.into()]].concat(),
        "compressed-ply" => splats(Format::CompressedPly),
        "splat" => splats(Format::Splat),
        "spz" => [splats(Format::Spz), vec![written(Format::Spz, 3, 3, SpzVersion::V4)]].concat(),
        "spz-inside" => splats(Format::Spz).iter().map(|file| unzipped(file)).collect(),
        "sog" => sogs(),
        "sog-inside" => sogs().iter().map(|file| parts(file, &targets::SOG_PARTS)).collect(),
        "glb" => vec![splat(Format::Glb, 2, 1), splat(Format::Glb, 1, 0)],
        "values" => values(),
        "config" => {
            vec![toml::to_string(&TrainConfig::default()).expect("defaults are text").into(), CONFIG.into()]
        }
        "checkpoint" => [0, 2].map(|rows| inside(checkpoint(rows))).into(),
        "weights" => vec![safetensors(), legacy()],
        "weights-inside" => {
            vec![wrap::framed(&[pickle(false), b"little".into(), b"3\n".into(), vec![1; 12]])]
        }
        "message" => vec![LOOK.into(), r#"{"type":"pause"}"#.into()],
        "request" => vec![REQUEST.into()],
        "camera-path" => vec![PATH.into()],
        "offset" => vec![br#"{"about":"a","offset":[431250.5,5412345,-3e2]}"#.to_vec()],
        other => panic!("{other} has no seeds"),
    }
}

/// Two pixels, as COLMAP and NumPy write them.
fn depths() -> Vec<Vec<u8>> {
    let values = [1.5f32, 2.5].map(f32::to_le_bytes).concat();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }\n";
    let magic = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes()].concat();
    vec![[&b"2&1&1&"[..], &values].concat(), [&magic[..], header.as_bytes(), &values].concat()]
}

/// One frame of two photos.
fn frames() -> Vec<u8> {
    let pose = [1.0f64, 0.0, 0.0, 0.0, 0.5, 0.0, 1.0].map(f64::to_le_bytes).concat();
    let entry = |id: u32| [&0i32.to_le_bytes()[..], &id.to_le_bytes(), &u64::from(id).to_le_bytes()].concat();
    [
        &1u64.to_le_bytes()[..],
        &1u32.to_le_bytes(),
        &1u32.to_le_bytes(),
        &pose,
        &2u32.to_le_bytes(),
        &entry(1),
        &entry(2),
    ]
    .concat()
}

/// Gaussians of numbers that are usual, that are as large as is believed, and that overflow when they are
/// used.
fn values() -> Vec<Vec<u8>> {
    let rows = [0.5f32, 1e9, -1e9, 20.7, 89.0, 3e38, f32::NAN];
    let row = |value: f32| [value.to_le_bytes(); targets::VALUES_PER_ROW].concat();
    vec![
        rows[..3].iter().flat_map(|value| row(*value)).collect(),
        rows[3..].iter().flat_map(|value| row(*value)).collect(),
    ]
}

const CONFIG: &str = "seed = 3\niterations = 700\nsteps_scale = 0.5\nbackground = \"random\"\n\
    [method]\nname = \"pixel-gs\"\ndensify_every = 100\n[genetic]\ngenerations = 3\n";

fn cloud(rows: usize) -> Gaussians {
    let rng = Rng::new(1);
    let value = |row: usize, column: u32| {
        rng.at(Stream::Test, row as u32, column / 4, 0).0[(column % 4) as usize] as f32 / 2.0f32.powi(31)
            - 1.0
    };
    let mut cloud = Gaussians::zeros(rows);
    for row in 0..rows {
        cloud.positions[row] = [0, 1, 2].map(|column| 5.0 * value(row, column));
        cloud.log_scales[row] = [4, 5, 6].map(|column| -4.0 + value(row, column));
        cloud.rotations[row] = [8, 9, 10, 11].map(|column| value(row, column));
        cloud.opacity_logits[row] = 3.0 * value(row, 12);
        cloud.sh[row] = std::array::from_fn(|slot| 0.3 * value(row, 16 + slot as u32));
    }
    cloud
}

fn splat(format: Format, rows: usize, sh_degree: u8) -> Vec<u8> {
    written(format, rows, sh_degree, SpzVersion::V3)
}

/// Without digits in their codebooks of 256 values, which would be most of the file.
fn sogs() -> Vec<Vec<u8>> {
    [0, 1]
        .map(|sh_degree| {
            let (options, mut cloud) = (Options { sh_degree, ..Options::default() }, Gaussians::zeros(2));
            cloud.sh[0][3] = f32::from(sh_degree);
            bytes::written(Format::Sog, &cloud, &options).expect("a small cloud is written")
        })
        .into()
}

fn written(format: Format, rows: usize, sh_degree: u8, spz_version: SpzVersion) -> Vec<u8> {
    let options = Options { sh_degree, spz_version, ..Options::default() };
    bytes::written(format, &cloud(rows), &options).expect("a small cloud is written")
}

fn model(file: &str) -> Vec<u8> {
    let camera =
        Intrinsics { width: 20, height: 16, focal_px: [20.0, 21.0], principal_px: [10.0, 8.0], lens: None };
    let image = |name: &str| ImageRecord {
        name: name.into(),
        camera: 1,
        rotation: [1.0, 0.0, 0.0, 0.0],
        translation: [0.5, 1.0, 2.0],
    };
    let model = Model {
        cameras: [(1, camera), (2, camera)].into(),
        images: vec![image("0001.png"), image("a/b.jpg")],
        points: vec![Point { position: [1.0, 2.0, 3.0], rgb: [1, 2, 3] }; 2],
        notices: Vec::new(),
    };
    in_folder(|folder| {
        write_model(folder, &model)?;
        fs::read(folder.join(file))
    })
}

fn photos() -> Vec<Vec<u8>> {
    let photo = |side: u32| Photo {
        width: side,
        height: side,
        rgb: (0..3 * side * side).map(|at| (at * at % 251) as u8).collect(),
    };
    let png = in_folder(|folder| {
        write_png(&folder.join("a.png"), &photo(5)).expect("a small picture is written");
        fs::read(folder.join("a.png"))
    });
    vec![png, encode_jpeg(&photo(9), 60)]
}

/// What `make` makes in a folder of its own, which is then removed.
fn in_folder(make: impl FnOnce(&Path) -> io::Result<Vec<u8>>) -> Vec<u8> {
    let folder = std::env::temp_dir().join(format!("genesplat-seeds-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder can be made");
    let bytes = make(&folder).expect("small files are written and read");
    fs::remove_dir_all(&folder).expect("it is ours");
    bytes
}

fn unzipped(gzip: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    io::copy(&mut flate2::read::GzDecoder::new(gzip), &mut bytes).expect("it was just compressed");
    bytes
}

fn parts(file: &[u8], names: &[&str]) -> Vec<u8> {
    let mut archive = zip::ZipArchive::new(io::Cursor::new(file)).expect("it was just written");
    let part = |name: &&str| {
        let mut bytes = Vec::new();
        let copied = archive.by_name(name).map(|mut file| io::copy(&mut file, &mut bytes));
        copied.ok().map_or_else(Vec::new, |_| bytes)
    };
    wrap::framed(&names.iter().map(part).collect::<Vec<_>>())
}

/// A run that has just begun, with so many Gaussians, and as many pictures of virtual views.
pub(crate) fn checkpoint(rows: usize) -> Vec<u8> {
    let state = DeviceState {
        cloud: cloud(rows),
        moments: Moments::zeros(rows),
        statistics: Statistics {
            gradient_sum: vec![0.0; rows],
            weight_sum: vec![0.0; rows],
            ..Statistics::default()
        },
        mean: StateMean::default(),
    };
    let (cursor, progress) = (Cursor::start_of(7), Progress::default());
    let virtual_pictures = vec![Photo { width: 2, height: 1, rgb: (0..6).collect() }.into(); rows];
    let mut bytes = Vec::new();
    let origin = String::from("seed = 7");
    let checkpoint = Checkpoint { origin, cursor, progress, state, virtual_pictures };
    checkpoint.write(&mut bytes).expect("memory takes it");
    bytes
}

/// Without magic number and checksum.
fn inside(checkpoint: Vec<u8>) -> Vec<u8> {
    checkpoint[8..checkpoint.len() - 8].to_vec()
}

fn safetensors() -> Vec<u8> {
    to_safetensors(
        &[("lin0.weight".to_owned(), Tensor { shape: vec![1, 3], values: vec![1.0, 2.0, 3.0] })].into(),
    )
}

fn text(value: &str) -> Vec<u8> {
    [&b"X"[..], &(value.len() as u32).to_le_bytes(), value.as_bytes()].concat()
}

/// `{name: tensor of shape [1, 3, 1, 1]}`, as `torch.save` writes it; before PyTorch 1.6, storages had an
/// entry more.
fn pickle(is_legacy: bool) -> Vec<u8> {
    let end: &[u8] = if is_legacy { b"K\x03NtQ" } else { b"K\x03tQ" };
    let storage =
        [b"(", &text("storage")[..], b"ctorch\nFloatStorage\n", &text("0"), &text("cpu"), end].concat();
    let shape = b"K\x00(K\x01K\x03K\x01K\x01t(K\x03K\x01K\x01K\x01t\x89ccollections\nOrderedDict\n)Rt";
    let tensor = [b"ctorch._utils\n_rebuild_tensor_v2\n(", &storage[..], shape, b"R"].concat();
    [b"\x80\x02}", &text("lin0.model.1.weight")[..], &tensor, b"s."].concat()
}

/// A file of PyTorch before 1.6: pickles, one after the other, then the values.
fn legacy() -> Vec<u8> {
    let pickle_of = |parts: &[&[u8]]| [&b"\x80\x02"[..], &parts.concat(), b"."].concat();
    [
        pickle_of(&[b"\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19"]),
        pickle_of(&[b"M\xe9\x03"]),
        pickle_of(&[b"}(", &text("protocol_version"), b"M\xe9\x03", &text("little_endian"), b"\x88u"]),
        pickle(true),
        pickle_of(&[b"]", &text("0"), b"a"]),
        3u64.to_le_bytes().to_vec(),
        vec![0; 12],
    ]
    .concat()
}

//! What people give, and what comes of it: each row makes its own mistake.

use std::fs;

use genesplat::core::Gaussians;
use genesplat::io::PlyOptions;
use genesplat::io::colmap::{find_model, read_model, write_model};
use genesplat::io::photos::{encode_jpeg, read_photo, write_png};

use super::Outcome::{Says, Works};
use super::{Mistake, Place, grey};
use crate::another_scene::write_of_another_scene;
use crate::bad_input::write_blender;
use crate::support::{copy, scene, succeed, text, train};

/// What was given is not quite a scene.
pub(super) const SCENES: &[Mistake] = &[
    (|place| place.trains("absent", &[]), Says(&["absent does not exist", "give the folder"])),
    (
        |place| {
            fs::create_dir(place.at("empty")).unwrap();
            place.trains("empty", &[])
        },
        Says(&["empty is not a scene", "sparse/0"]),
    ),
    (
        |place| {
            copy(&scene().join("images"), &place.at("photos"));
            place.trains("photos", &[])
        },
        Says(&["photos holds 12 photos and no cameras", "genesplat poses", "--poses"]),
    ),
    (
        |place| {
            place.write("film.mp4", "x");
            place.trains("film.mp4", &[])
        },
        Says(&["film.mp4 is a video", "genesplat poses"]),
    ),
    (
        |place| {
            place.write("scene.zip", "PK");
            place.trains("scene.zip", &[])
        },
        Says(&["scene.zip cannot be read", "copy or download it again, or unpack it by hand"]),
    ),
    (
        |place| {
            place.write("scene.tar.gz", "x");
            place.trains("scene.tar.gz", &[])
        },
        Says(&["scene.tar.gz is an archive", "unpack it"]),
    ),
    (
        |place| {
            place.zip("scene", "scene.zip");
            place.trains("scene.zip", &[])
        },
        Works(&["15 files of", "scene.zip are unpacked into", "run/scene"]),
    ),
    (
        |place| {
            place.zip("scene/images", "photos.zip");
            place.trains("photos.zip", &[])
        },
        Says(&["run/scene holds 12 photos and no cameras", "genesplat poses"]),
    ),
    (
        |place| {
            place.zip("scene", "scene.zip");
            place.write("run/scene/mine.txt", "x");
            place.trains("scene.zip", &[])
        },
        Says(&["run/scene is there already", "choose another --out"]),
    ),
    // Killed in its first write.
    (
        |place| {
            place.zip("scene", "scene.zip");
            place.write("run/scene/.genesplat-7-0.tmp", "half");
            place.trains("scene.zip", &[])
        },
        Works(&["are unpacked into"]),
    ),
    (
        |place| {
            place.zip("scene", "scene.zip");
            succeed(place.trains("scene.zip", &[]));
            fs::remove_file(place.at("run/metrics.json")).unwrap();
            place.zip("scene/images", "scene.zip");
            place.trains("scene.zip", &[])
        },
        Says(&["unpacked from another archive", "choose another --out"]),
    ),
    (|place| place.trains("scene/images/gallery_003.png", &[]), Works(&["of which a part was given"])),
    (
        |place| {
            fs::copy(place.photo(), place.at("one.png")).unwrap();
            place.trains("one.png", &[])
        },
        Says(&["one.png is one photo", "give the folder"]),
    ),
    (
        |place| {
            place.write("phone/IMG_1.HEIC", "x");
            place.trains("phone", &[])
        },
        Says(&["phone holds 1 picture that is", "neither JPEG nor PNG nor WebP", "heif-convert"]),
    ),
    (|place| place.trains("scene/images", &[]), Works(&["of which a part was given"])),
    (
        |place| {
            fs::rename(place.at("scene/images"), place.at("scene/images_4")).unwrap();
            place.trains("scene", &[])
        },
        Says(&["images_4 has photos of these names, so give --images images_4"]),
    ),
    (
        |place| {
            fs::rename(place.at("scene/images"), place.at("scene/images_4")).unwrap();
            place.trains("scene", &["--images", "images_4"])
        },
        Works(&[]),
    ),
    (|place| place.trains("scene/sparse/0", &[]), Works(&["of which a part was given"])),
    (|place| place.trains("scene/sparse/0/cameras.bin", &[]), Works(&["of which a part was given"])),
    (|place| place.trains("", &[]), Works(&["of which a part was given"])),
    (
        |place| {
            copy(&place.at("scene/images"), &place.at("other/images"));
            copy(&place.at("scene/sparse/0"), &place.at("other/sparse/0"));
            place.trains("", &[])
        },
        Says(&["several COLMAP models", "other/sparse/0", "scene/sparse/0", "give the folder"]),
    ),
    (
        |place| {
            write_blender(&place.at("blender"));
            place.trains("blender/transforms_train.json", &[])
        },
        Says(&["4 photos with cameras", "fewer than 10", "--anyway"]),
    ),
    (
        |place| {
            write_blender(&place.at("blender"));
            place.trains("blender/transforms_train.json", &["--anyway"])
        },
        Works(&["of which a part was given", "no points", "4 photos with cameras"]),
    ),
    (
        |place| {
            (0..13).for_each(|at| {
                _ = fs::copy(place.photo(), place.at(&format!("scene/images/x{at}.png"))).unwrap()
            });
            place.trains("scene", &[])
        },
        Says(&["only 12 of the 25 photos have a camera", "--anyway"]),
    ),
    // Photos beside their list, and a list in a folder of its own.
    (
        |place| {
            copy(&place.at("scene/images"), &place.at("flat"));
            copy(&place.at("scene/sparse/0"), &place.at("flat"));
            place.trains("flat", &[])
        },
        Works(&["the photos are those in", "beside their list"]),
    ),
    (
        |place| {
            copy(&place.at("scene/images"), &place.at("work/input"));
            copy(&place.at("scene/sparse/0"), &place.at("work/distorted/sparse/0"));
            place.trains("work", &[])
        },
        Says(&["distorted/sparse/0/images.bin lists", "give --images input"]),
    ),
    (
        |place| {
            copy(&place.at("scene/images"), &place.at("work/input"));
            copy(&place.at("scene/sparse/0"), &place.at("work/distorted/sparse/0"));
            place.trains("work", &["--images", "input"])
        },
        Works(&["the cameras are those of the COLMAP model in", "distorted/sparse/0"]),
    ),
    // As other trainers call their flags.
    (
        |place| {
            let [scene, run] = [place.at("scene"), place.at("run")];
            ["train", "--data", text(&scene), "--output", text(&run), "--max-steps", "2", "--device", "cpu"]
                .map(str::to_owned)
                .into()
        },
        Works(&[]),
    ),
    (
        |place| {
            place.rename("scene/sparse", "scene/colmap/sparse");
            place.trains("scene", &[])
        },
        Works(&[]),
    ),
    (
        |place| {
            succeed(place.trains("scene", &[]));
            train(&place.at("run"), &place.at("again"), &[])
        },
        Says(&["run is the folder of a run", "give the folder of a scene"]),
    ),
    (|place| train(&place.at("scene"), &place.at("scene"), &[]), Says(&["is the folder of the scene"])),
    (
        |place| train(&place.at("scene"), &place.at("scene/images"), &[]),
        Says(&["lies in images/ of the scene"]),
    ),
    (
        |place| train(&place.at("scene"), &place.at("scene/sparse/run"), &[]),
        Says(&["lies in sparse/ of the scene"]),
    ),
    (
        |place| {
            place.write("run/point_cloud_fused.ply", "theirs");
            place.trains("scene", &["--method", "mip-splatting"])
        },
        Says(&["point_cloud_fused.ply belongs to something else"]),
    ),
];

/// Photos are not quite where and what the list says.
pub(super) const PHOTOS: &[Mistake] = &[
    (
        |place| {
            place.rename("scene/images/gallery_003.png", "scene/images/GALLERY_003.PNG");
            place.trains("scene", &[])
        },
        Works(&["1 photo has another case or ending than", "GALLERY_003.PNG for gallery_003.png"]),
    ),
    (
        |place| {
            place.rename("scene/images/gallery_003.png", "scene/images/gallery_003.jpg");
            place.trains("scene", &[])
        },
        Works(&["gallery_003.jpg for gallery_003.png"]),
    ),
    (
        |place| {
            place.rename("scene/images", "scene/Images");
            place.trains("scene", &[])
        },
        Works(&[]),
    ),
    (
        |place| {
            fs::remove_file(place.photo()).unwrap();
            place.trains("scene", &[])
        },
        Works(&["1 of the 12 photos", "left out", "gallery_003.png"]),
    ),
    (
        |place| {
            fs::remove_dir_all(place.at("scene/images")).unwrap();
            place.trains("scene", &[])
        },
        Says(&["none of the 12 photos", "put the photos there"]),
    ),
    (
        |place| {
            fs::remove_dir_all(place.at("scene/images")).unwrap();
            place.write("scene/images/IMG_1.jpg", "x");
            place.trains("scene", &[])
        },
        Says(&["none of the 12 photos", "IMG_1.jpg where gallery_0", "put the photos there"]),
    ),
    (
        |place| {
            fs::remove_dir_all(place.at("scene/images")).unwrap();
            place.write("scene/images/gallery_000.heic", "x");
            place.trains("scene", &[])
        },
        Says(&["none of the 12 photos", "gallery_000.heic that are not read", "heif-convert"]),
    ),
    (
        |place| {
            fs::write(place.photo(), b"\0\0\0\x18ftypheic\0\0\0\0").unwrap();
            place.trains("scene", &[])
        },
        Works(&[
            "1 of the 12 photos cannot be used and is left out",
            "gallery_003.png",
            "HEIC",
            "only PNG, JPEG and WebP are read",
        ]),
    ),
    (
        |place| {
            fs::write(place.photo(), "hello").unwrap();
            place.trains("scene", &[])
        },
        Works(&[
            "1 of the 12 photos cannot be used and is left out",
            "gallery_003.png",
            "neither a PNG nor a JPEG nor a WebP",
            "export it again",
        ]),
    ),
    (
        |place| {
            let jpeg = encode_jpeg(&read_photo(&place.photo()).unwrap(), 90);
            fs::write(place.photo(), &jpeg[..jpeg.len() - 300]).unwrap();
            place.trains("scene", &[])
        },
        Works(&[
            "1 of the 12 photos cannot be used and is left out",
            "gallery_003.png",
            "cut off",
            "export it again",
        ]),
    ),
    (
        |place| {
            let jpeg = encode_jpeg(&read_photo(&place.photo()).unwrap(), 90);
            fs::write(place.photo(), jpeg).unwrap();
            place.trains("scene", &[])
        },
        Works(&[]),
    ),
    (
        |place| {
            write_png(&place.photo(), &grey(48, 64)).unwrap();
            place.trains("scene", &[])
        },
        Works(&[
            "1 of the 12 photos cannot be used and is left out",
            "gallery_003.png is 48x64",
            "64x48",
            "another shape",
        ]),
    ),
    (|place| place.trains("scene", &["--max-side", "4000"]), Works(&[])),
    (
        |place| {
            write_png(&place.at("scene/masks/gallery_003.png"), &grey(20, 20)).unwrap();
            place.trains("scene", &[])
        },
        Says(&["masks/gallery_003.png is a mask of 20x20", "64x48", "as large as its photo"]),
    ),
    (
        |place| place.trains("scene", &["--depth", "on"]),
        Says(&["no photo has a depth map", "leave out --depth on"]),
    ),
    (|place| ["inspect", text(&place.at("scene/sparse/0/images.bin"))].map(str::to_owned).into(), Works(&[])),
    (
        |place| {
            write_png(&place.at("scene/masks/3.png"), &grey(64, 48)).unwrap();
            place.trains("scene", &[])
        },
        Says(&["masks has no mask of any photo", "gallery_000.png.png", "like 3.png", "--mask off"]),
    ),
    (
        |place| {
            write_png(&place.at("scene/masks/3.png"), &grey(64, 48)).unwrap();
            place.trains("scene", &["--mask", "off"])
        },
        Works(&[]),
    ),
    (
        |place| {
            write_png(&place.at("scene/masks/gallery_003.png.mask.png"), &grey(64, 48)).unwrap();
            place.trains("scene", &[])
        },
        Works(&["1 of 12 photos have a mask"]),
    ),
    // As Notepad writes it.
    (
        |place| {
            let units = "\u{feff}gallery_003.png\r\n".encode_utf16().flat_map(u16::to_le_bytes);
            place.write("list.txt", units.collect::<Vec<_>>());
            place.trains("scene", &["--test-list", text(&place.at("list.txt"))])
        },
        Works(&[]),
    ),
    (
        |place| {
            place.write("list.txt", "gallery_99.png");
            place.trains("scene", &["--test-list", text(&place.at("list.txt"))])
        },
        Says(&["no photo called gallery_99.png", "names like gallery_0"]),
    ),
    (
        |place| place.trains("scene", &["--test-list", text(&place.at("list.txt"))]),
        Says(&["cannot read the list", "list.txt"]),
    ),
];

/// A model or a splat is not quite one.
pub(super) const MODELS: &[Mistake] = &[
    (
        |place| {
            fs::remove_file(place.at("scene/sparse/0/points3D.bin")).unwrap();
            place.trains("scene", &[])
        },
        Works(&["no points", "100000 random ones"]),
    ),
    (
        |place| {
            fs::remove_file(place.at("scene/sparse/0/cameras.bin")).unwrap();
            place.trains("scene", &[])
        },
        Says(&["sparse/0 has no cameras.bin beside images.bin", "copy all files"]),
    ),
    (
        |place| {
            fs::remove_file(place.at("scene/sparse/0/images.bin")).unwrap();
            place.trains("scene", &[])
        },
        Says(&["sparse/0 has no images.bin beside cameras.bin", "copy all files"]),
    ),
    (
        |place| {
            let found = find_model(&place.at("scene")).unwrap();
            let mut model = read_model(&found).unwrap();
            model.images.truncate(1);
            write_model(&found.path, &model).unwrap();
            place.trains("scene", &[])
        },
        Says(&["not enough photos", "add photos"]),
    ),
    (
        |place| {
            place.write("mesh.ply", MESH);
            place.evaluates("mesh.ply")
        },
        Says(&["mesh.ply is a mesh", "give a splat"]),
    ),
    (
        |place| {
            place.write(
                "points.ply",
                MESH.replace("element face 0\nproperty list uchar int vertex_indices\n", ""),
            );
            place.evaluates("points.ply")
        },
        Says(&["points.ply is a point cloud", "give a splat"]),
    ),
    (
        |place| {
            let mut cloud = Gaussians::zeros(3);
            cloud.opacity_logits = vec![f32::INFINITY, f32::NEG_INFINITY, 0.0];
            genesplat::io::write_ply(&place.at("splat.ply"), &cloud, &PlyOptions::default()).unwrap();
            place.evaluates("splat.ply")
        },
        Works(&[]),
    ),
    (
        |place| {
            let mut cloud = Gaussians::zeros(3);
            cloud.opacity_logits[1] = f32::NAN;
            genesplat::io::write_ply(&place.at("splat.ply"), &cloud, &PlyOptions::default()).unwrap();
            place.evaluates("splat.ply")
        },
        Says(&["splat.ply", "Gaussian 1 is not finite"]),
    ),
    (|place| refines_another(place, &[]), Says(&["splat of another scene", "--anyway"])),
    (|place| refines_another(place, &["--anyway", "--iterations", "1"]), Works(&[])),
    (
        |place| place.evaluates("scene"),
        Says(&["scene is a scene, of which there is no splat yet", "genesplat train"]),
    ),
    (|place| place.evaluates("scene/images/gallery_003.png"), Says(&["gallery_003.png is not a PLY"])),
    (
        |place| train(&place.at("scene"), &place.at("run"), &["--resume"]),
        Says(&["run is not the folder of a run", "give one that train made"]),
    ),
];

const MESH: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n";

/// `refine` on a splat of another scene: nothing is where the photos have it.
fn refines_another(place: &Place, more: &[&str]) -> Vec<String> {
    let [splat, out] = [place.at("splat.ply"), place.at("out.ply")];
    write_of_another_scene(&splat);
    let on = ["refine", text(&splat), "--data", text(scene()), "--out", text(&out), "--device", "cpu"];
    on.iter().chain(more).map(|word| (*word).to_owned()).collect()
}

//! Code that lies in the folder of the photos, under names that genesplat, or what it starts, looks for: none
//! of it runs.

use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

use crate::poses::said;
use crate::support::{command, copy, judge_failure, program, scene, succeed, text, train};

/// What the scripts import, what Python itself does, and what it looks for when it begins.
const MODULES: [&str; 14] = [
    "json",
    "os",
    "threading",
    "time",
    "numpy",
    "pycolmap",
    "pillow_heif",
    "PIL",
    "linecache",
    "traceback",
    "codecs",
    "encodings",
    "sitecustomize",
    "usercustomize",
];
const PROGRAMS: [&str; 5] = ["python3", "python", "colmap", "ffmpeg", "ffprobe"];

/// A folder of photos, with code that leaves a mark.
struct Planted {
    place: TempDir,
    photos: PathBuf,
}

impl Planted {
    fn new() -> Self {
        let place = tempfile::tempdir().unwrap();
        let this = Self { photos: place.path().join("photos"), place };
        copy(&scene().join("images"), &this.photos);
        for module in MODULES {
            let code = format!("open({:?}, 'a').write('{module} ')\n", text(&this.mark()));
            fs::write(this.photos.join(module).with_extension("py"), code).unwrap();
        }
        for program in PROGRAMS {
            let file = this.photos.join(program);
            fs::write(&file, format!("#!/bin/sh\necho {program} >>'{}'\n", text(&this.mark()))).unwrap();
            fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
        }
        this
    }

    fn mark(&self) -> PathBuf {
        self.place.path().join("mark")
    }

    /// What was run.
    fn ran(&self) -> String {
        fs::read_to_string(self.mark()).unwrap_or_default()
    }

    /// Modules of the user's own.
    fn modules(&self) -> PathBuf {
        let own = self.place.path().join("own");
        fs::create_dir_all(own.join("PIL")).unwrap();
        fs::write(own.join("pycolmap.py"), include_str!("pycolmap_pretended.py")).unwrap();
        fs::write(own.join("numpy.py"), "").unwrap();
        fs::write(own.join("pillow_heif.py"), "def register_heif_opener(): pass\n").unwrap();
        fs::write(own.join("PIL/__init__.py"), "").unwrap();
        let photo = scene().join("images/gallery_000.png");
        let image = format!(
            "import io, shutil\nclass Image:\n    info = {{}}\n    def convert(self, _): return self\n    \
             def save(self, to, *_, **__): shutil.copyfileobj(io.open({:?}, 'rb'), to)\ndef open(_): return Image()\n",
            text(&photo)
        );
        fs::write(own.join("PIL/Image.py"), image).unwrap();
        own
    }

    /// The command in the folder of the photos, which `PATH` and `PYTHONPATH` name in several ways; by its
    /// whole name only where the command knows that photos are there.
    fn run(&self, arguments: &[&str], path: &[&Path]) -> Output {
        let list = |own: &[&Path]| -> OsString {
            let strange = [Path::new(""), Path::new("."), Path::new("../photos"), &self.photos];
            let strange = &strange[..if arguments[0] == "poses" { 4 } else { 3 }];
            std::env::join_paths([strange, own, strange].concat()).unwrap()
        };
        command(arguments)
            .current_dir(&self.photos)
            .env("PATH", list(path))
            .env("PYTHONPATH", list(&[&self.modules()]))
            .env("PYTHONPYCACHEPREFIX", ".")
            .env("GENESPLAT_TEST_MODEL", scene().join("sparse/0"))
            .env_remove("GENESPLAT_PYTHON")
            .output()
            .unwrap()
    }
}

/// The folders of `PATH` that have real programs.
fn path() -> Vec<PathBuf> {
    let list = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&list).filter(|folder| folder.is_absolute()).collect()
}

#[test]
fn code_in_the_folder_of_the_photos_does_not_run() {
    if program("python3").is_none() {
        return;
    }
    let planted = Planted::new();
    fs::write(planted.photos.join("gallery_000.HEIC"), "x").unwrap();
    fs::remove_file(planted.photos.join("gallery_000.png")).unwrap();
    let path = path();
    let found = planted
        .run(&["poses", ".", "--out", "../scene"], &path.iter().map(|path| &**path).collect::<Vec<_>>());
    assert_eq!(planted.ran(), "", "{}", said(&found));
    assert!(found.status.success() && said(&found).contains("pycolmap pretended"), "{}", said(&found));
    assert!(planted.place.path().join("scene/images/gallery_000.HEIC.jpg").exists());
    // The counterpart: it would run where Python adds the folder by itself.
    let mut python = Command::new(program("python3").unwrap());
    let ran = python.args(["-c", "import pycolmap"]).current_dir(&planted.photos).output();
    assert!(ran.is_ok() && planted.ran().contains("pycolmap"), "{}", planted.ran());
}

#[test]
fn programs_in_the_folder_of_the_photos_do_not_run() {
    let planted = Planted::new();
    let nobody = planted.run(&["poses", ".", "--out", "../scene"], &[]);
    judge_failure(nobody, &["no Python on PATH"]);
    fs::write(planted.photos.join("film.mp4"), "no film").unwrap();
    let film = planted.run(&["poses", "film.mp4", "--out", "../of-film"], &[]);
    assert!(!film.status.success() && planted.ran().is_empty(), "{}", said(&film));
    if let Some(python) = program("python3") {
        let only = planted.place.path().join("bin");
        fs::create_dir(&only).unwrap();
        std::os::unix::fs::symlink(python.canonicalize().unwrap(), only.join("python3")).unwrap();
        // Not the one of a version manager, which is a script that looks for itself.
        let film = planted.run(&["poses", "film.mp4", "--out", "../of-film"], &[&only]);
        assert!(planted.ran().is_empty() && !film.status.success(), "{} {}", planted.ran(), said(&film));
    }
    let run = planted.place.path().join("run");
    succeed(train(scene(), &run, &["--iterations", "40"]));
    let render = [
        "render",
        text(&run),
        "--data",
        text(scene()),
        "--device",
        "cpu",
        "--path",
        "orbit",
        "--out",
        "../x.mp4",
    ];
    judge_failure(planted.run(&render, &[]), &["there is no ffmpeg on the PATH"]);
    assert_eq!(planted.ran(), "");
}

/// Elsewhere it would be a path out of the scene.
#[test]
fn a_photo_whose_name_has_backslashes_is_written_nowhere() {
    let planted = Planted::new();
    let photo = scene().join("images/gallery_000.png");
    fs::create_dir(planted.photos.join("a")).unwrap();
    fs::copy(&photo, planted.photos.join("a\\..\\..\\x.png")).unwrap();
    // What it would be read from.
    fs::copy(&photo, planted.place.path().join("x.png")).unwrap();
    let deep = planted.place.path().join("deep");
    judge_failure(
        planted.run(&["poses", ".", "--out", text(&deep.join("scene"))], &[]),
        &["x.png", "backslash", "rename it"],
    );
    assert!(!deep.exists());
}

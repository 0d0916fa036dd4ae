//! `render --path`: a camera that moves.

use std::fs;

use genesplat::io::photos::read_photo;

use crate::support::{command, fail, judge_failure, program, scene, succeed, text, train};

const VIEW: [&str; 2] = [
    r#"{"position":[0,0,1],"rotation":[1,0,0,0],"fov_y":0.9}"#,
    r#"{"position":[0.2,0,1.5],"rotation":[0.9,0.1,0,0],"fov_y":0.9}"#,
];

#[test]
fn a_path_becomes_pictures_that_differ() {
    let folder = tempfile::tempdir().unwrap();
    let [run, out, file] = ["run", "frames", "path.json"].map(|name| folder.path().join(name));
    succeed(train(scene(), &run, &["--iterations", "40"]));
    fs::write(&file, format!(r#"{{"genesplat_path":1,"views":[{}]}}"#, VIEW.join(","))).unwrap();
    let arguments = |path: &str| {
        let fixed =
            ["render", text(&run), "--data", text(scene()), "--device", "cpu", "--frames", "5", "--path"];
        [&fixed[..], &[path, "--out"]].concat().into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let with = |path: &str, out: &str| [arguments(path), vec![out.to_owned()]].concat();
    for path in ["orbit", "spiral", "interpolate", text(&file)] {
        succeed(with(path, text(&out)));
        let frame = |index: u32| read_photo(&out.join(format!("{index:04}.png"))).unwrap();
        assert_eq!((frame(1).width, frame(1).height), (64, 48), "{path}");
        assert!((1..5).all(|index| frame(index) != frame(index + 1)), "{path} stands still");
    }
    let shorter =
        with("orbit", text(&out)).into_iter().map(|word| if word == "5" { "3".to_owned() } else { word });
    fail(shorter.collect::<Vec<_>>(), &["0004.png would be a frame of another path", "--out"]);
    fs::write(&file, r#"{"genesplat_path":1,"views":[]}"#).unwrap();
    fail(with(text(&file), text(&out)), &["path.json", "from 2 to"]);
    fail(with("absent.json", text(&out)), &["cannot read the path absent.json"]);
    let splat = run.join("point_cloud.ply");
    let film = run.join("test.mp4");
    let nowhere = command(with("orbit", text(&film))).env("PATH", folder.path()).output().unwrap();
    judge_failure(nowhere, &["there is no ffmpeg", "--out a folder"]);
    let before = fs::read(&splat).unwrap();
    fail(with("orbit", text(&splat)), &["is a file"]);
    assert!(fs::read(&splat).unwrap() == before && !film.exists());
}

#[test]
fn ffmpeg_makes_films_where_it_is_there() {
    if program("ffmpeg").is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(train(scene(), &run, &["--iterations", "40"]));
    // What stands for a number in names of pictures is a name like any other.
    let names =
        [("film.mp4", &b"ftyp"[..]), ("film.gif", b"GIF8"), ("100%.mp4", b"ftyp"), ("a:%03d.gif", b"GIF8")];
    for (name, magic) in names {
        let film = folder.path().join(name);
        let path = ["--path", "orbit", "--frames", "6", "--out", text(&film)];
        succeed([&["render", text(&run), "--data", text(scene()), "--device", "cpu"][..], &path].concat());
        assert!(fs::read(&film).unwrap()[..12].windows(4).any(|bytes| bytes == magic), "{name}");
        let left = fs::read_dir(folder.path()).unwrap().count();
        assert!(left <= 5, "{left} files");
    }
}

/// A program that keeps the frames as they are stands for ffmpeg.
#[cfg(unix)]
#[test]
fn a_film_is_written_into_a_file_of_ours_and_takes_the_place_that_a_link_leads_to() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let [run, programs, out] = ["run", "programs", "out"].map(|name| folder.path().join(name));
    succeed(train(scene(), &run, &["--iterations", "3"]));
    [&programs, &out].into_iter().for_each(|folder| fs::create_dir(folder).unwrap());
    // The file is there, and a file, before ffmpeg opens it.
    let program = "#!/bin/sh\nfor file; do :; done\nfile=\"${file#file:}\"\n[ -f \"$file\" ] && [ ! -L \"$file\" ] && cat >\"$file\"\n";
    fs::write(programs.join("ffmpeg"), program).unwrap();
    fs::set_permissions(programs.join("ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let [link, film] = ["link%d.gif", "film.gif"].map(|name| out.join(name));
    std::os::unix::fs::symlink("film.gif", &link).unwrap();
    let arguments = ["render", text(&run), "--data", text(scene()), "--device", "cpu", "--path", "orbit"];
    let more = ["--frames", "3", "--out", text(&link)];
    let rendered = command(arguments.iter().chain(&more)).env("PATH", path).output().unwrap();
    assert!(rendered.status.success(), "{}", String::from_utf8_lossy(&rendered.stderr));
    assert!(link.is_symlink() && fs::metadata(&film).unwrap().len() == 3 * 64 * 48 * 3);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 2);
}

#[cfg(unix)]
fn is_png(file: &std::path::Path) -> bool {
    file.extension().is_some_and(|ending| ending == "png")
}

/// A program that takes frames for ever stands for ffmpeg.
#[cfg(unix)]
#[test]
fn what_is_rendered_is_stopped_between_frames_and_leaves_no_litter() {
    use std::os::unix::fs::PermissionsExt;
    use std::process::{Command, Stdio};

    let folder = tempfile::tempdir().unwrap();
    let [run, programs, out] = ["run", "programs", "out"].map(|name| folder.path().join(name));
    succeed(train(scene(), &run, &["--iterations", "3"]));
    fs::create_dir_all(&out).unwrap();
    fs::create_dir(&programs).unwrap();
    let ffmpeg = programs.join("ffmpeg");
    // The last word is the file to write, after its protocol.
    let program =
        "#!/bin/sh\nfor file; do :; done\n: >\"${file#file:}\"\n: >\"$0.began\"\nexec cat >/dev/null\n";
    fs::write(&ffmpeg, program).unwrap();
    fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    for (name, said) in [("film.mp4", "no "), ("frames", "frames are in")] {
        let place = out.join(name);
        let arguments = ["render", text(&run), "--data", text(scene()), "--device", "cpu", "--path", "orbit"];
        let mut command = command(arguments.iter().chain(&["--frames", "10000", "--out", text(&place)]));
        let child = command.env("PATH", &path).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let has_frame =
            || fs::read_dir(&place).is_ok_and(|mut files| files.any(|file| is_png(&file.unwrap().path())));
        while !programs.join("ffmpeg.began").exists() || (name == "frames" && !has_frame()) {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(
            output.status.code() == Some(130) && text.contains("stopped") && text.contains(said),
            "{text}"
        );
        assert_eq!(fs::read_dir(&out).unwrap().count(), usize::from(name == "frames"), "{name}");
    }
}

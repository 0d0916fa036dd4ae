//! Archives: what a scene consists of comes out whole, and nothing of a hostile one does.

use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;

use genesplat_io::archive::{Unpacked, is_zip, unpack};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

fn zip(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in entries {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// What was unpacked, or the sentence, and what there is then in the folder.
fn unpacked(bytes: &[u8]) -> (Result<Unpacked, String>, Vec<String>) {
    let place = tempfile::tempdir().unwrap();
    let [archive, folder] = ["a.zip", "out/below"].map(|name| place.path().join(name));
    fs::write(&archive, bytes).unwrap();
    assert!(is_zip(&archive) && !is_zip(&folder));
    let result = unpack(&archive, &folder).map_err(|error| error.to_string());
    fs::remove_file(&archive).unwrap();
    let mut files = Vec::new();
    list(place.path(), &mut files);
    files.sort();
    (result, files)
}

fn list(folder: &Path, files: &mut Vec<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            list(&path, files);
        } else {
            let name = path.file_name().unwrap().to_string_lossy();
            files.push(format!("{name}: {}", String::from_utf8_lossy(&fs::read(&path).unwrap())));
        }
    }
}

#[test]
fn photos_and_models_come_out_and_nothing_else_does() {
    let entries: [(&str, &[u8]); 7] = [
        ("scene/images/1.JPG", b"one"),
        ("scene/images/a/../2.png", b"two"),
        ("scene/sparse/0/points3D.bin", &[b'p'; 5000]),
        ("scene/run.sh", b"rm"),
        ("__MACOSX/images/._1.jpg", b"x"),
        ("scene/.hidden/3.png", b"x"),
        ("scene/readme", b"x"),
    ];
    let (result, files) = unpacked(&zip(&entries));
    let points = format!("points3D.bin: {}", "p".repeat(5000));
    let expected = Unpacked { files: 3, unread: Vec::new() };
    assert_eq!((result, files), (Ok(expected), vec!["1.JPG: one".into(), "2.png: two".into(), points]));
}

#[test]
fn hostile_and_damaged_archives_are_refused_before_anything_is_written() {
    let whole = zip(&[("images/1.png", b"some content"), ("2.png", b"more")]);
    let at = |bytes: &[u8], mark: &[u8]| bytes.windows(mark.len()).position(|window| window == mark).unwrap();
    let mut locked = whole.clone();
    // The flag of the first entry in the list at the end.
    locked[at(&whole, b"PK\x01\x02") + 8] |= 1;
    let mut linked = ZipWriter::new(Cursor::new(Vec::new()));
    linked.add_symlink("images.png", "/etc/passwd", SimpleFileOptions::default()).unwrap();
    let cases = [
        (zip(&[("../../1.png", b"x")]), "../../1.png, which leads out"),
        (zip(&[("/tmp/1.png", b"x"), ("C:\\1.png", b"x"), ("a/../../1.png", b"y")]), "leads out"),
        (zip(&[("a\\..\\..\\1.png", b"x")]), "leads out"),
        (zip(&[("a/../1.png", b"x"), ("1.png", b"y")]), "1.png twice"),
        (zip(&[("C:\\1.png", b"x")]), "leads out"),
        (zip(&[("a/1.png", b"x"), ("./a//1.png", b"y")]), "a/1.png twice"),
        (zip(&[("a/1.png", b"x"), ("a\\1.png", b"y")]), "a/1.png twice"),
        (linked.finish().unwrap().into_inner(), "images.png, which is a link"),
        (locked, "locked by a password"),
        (zip(&[("a/1.png", b"x"), ("A/1.PNG", b"y")]), "1.PNG twice"),
        (zip(&[("1.png", &vec![0; 70 << 20])]), "claims to hold 73400320 bytes"),
        (zip(&[("notes.md", b"x")]), "holds no photos and no scene"),
        (whole[..whole.len() - 9].to_vec(), "cannot be read"),
        (b"PK".to_vec(), "cannot be read"),
    ];
    for (bytes, problem) in cases {
        let (result, files) = unpacked(&bytes);
        let sentence = result.unwrap_err();
        assert!(sentence.contains("a.zip") && sentence.contains(problem), "{sentence}");
        assert!(sentence.contains("unpack it by hand") && files.is_empty(), "{files:?}");
    }
}

/// Programs take the first of them, or the last; the crate that reads them, too, would not tell.
#[test]
fn two_entries_of_one_name_are_refused() {
    let mut bytes = zip(&[("1.png", b"one"), ("2.png", b"two"), ("notes.md", b"x"), ("Notes.md", b"x")]);
    assert_eq!(unpacked(&bytes).1.len(), 2);
    let rename = |bytes: &mut Vec<u8>, from: &[u8], to: &[u8]| {
        for at in 0..=bytes.len() - from.len() {
            if bytes[at..].starts_with(from) {
                bytes[at..at + to.len()].copy_from_slice(to);
            }
        }
    };
    let mut others = bytes.clone();
    rename(&mut bytes, b"2.png", b"1.png");
    rename(&mut others, b"Notes.md", b"notes.md");
    for bytes in [bytes, others] {
        let (result, files) = unpacked(&bytes);
        let sentence = result.unwrap_err();
        assert!(sentence.contains("a.zip holds two entries of one name") && files.is_empty(), "{sentence}");
    }
}

#[test]
fn an_archive_of_more_entries_than_scenes_have_is_refused_before_its_list_is_read() {
    for (entries, is_refused) in [(100_000, false), (100_001, true)] {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for entry in 0..entries {
            zip.add_directory(entry.to_string(), SimpleFileOptions::default()).unwrap();
        }
        let sentence = unpacked(&zip.finish().unwrap().into_inner()).0.unwrap_err();
        let refused = "claims to hold 100001 entries, and at most 100000 are unpacked";
        assert!(sentence.contains(if is_refused { refused } else { "holds no photos" }), "{sentence}");
    }
}

#[test]
fn a_file_with_another_checksum_is_not_written() {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    zip.start_file("1.png", stored).unwrap();
    zip.write_all(b"content").unwrap();
    let mut bytes = zip.finish().unwrap().into_inner();
    let at = bytes.windows(7).position(|window| window == b"content").unwrap();
    bytes[at] = b'C';
    let (result, files) = unpacked(&bytes);
    let sentence = result.unwrap_err();
    assert!(sentence.contains("is damaged at 1.png") && files.is_empty(), "{sentence} {files:?}");
}

#[test]
fn pictures_of_other_formats_are_counted() {
    let (result, files) = unpacked(&zip(&[("a/1.HEIC", b"x"), ("a/2.jpg", b"two"), ("._3.heic", b"x")]));
    let expected = Unpacked { files: 1, unread: vec!["a/1.HEIC".into()] };
    assert_eq!((result, files), (Ok(expected), vec!["2.jpg: two".into()]));
    let (result, files) = unpacked(&zip(&[("1.heic", b"x")]));
    let sentence = result.unwrap_err();
    assert!(
        sentence.contains("others are not read (1.heic); convert them") && files.is_empty(),
        "{sentence}"
    );
}

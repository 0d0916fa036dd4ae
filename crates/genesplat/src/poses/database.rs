//! Which COLMAP has written a database: an older one fails on it, in words of SQL.

use std::io::Read;
use std::path::Path;

use genesplat::io::input;

/// Major and minor.
pub(crate) type Version = [u32; 2];

/// Where SQLite has the `user_version` of a database, which COLMAP sets to its own version.
const USER_VERSION_AT: usize = 60;
/// Of COLMAP 4.2.1 it is 4,020,100; the numbers of versions before 3.13 are smaller than this.
const TWO_DIGITS_EACH: u32 = 1_000_000;

/// The version of the COLMAP that has written the database last, where it is one that says so.
pub(crate) fn written_by(database: &Path) -> Option<Version> {
    let mut header = [0; USER_VERSION_AT + 4];
    input::open(database).ok()?.read_exact(&mut header).ok()?;
    let number = u32::from_be_bytes(header[USER_VERSION_AT..].try_into().ok()?);
    (number >= TWO_DIGITS_EACH).then_some([number / TWO_DIGITS_EACH, number / 10_000 % 100])
}

/// `4.2.1` and `COLMAP 3.8 (Commit ...)`.
pub(crate) fn version_in(words: &str) -> Option<Version> {
    let word = words.split_whitespace().find(|word| word.starts_with(|c: char| c.is_ascii_digit()))?;
    let mut numbers = word.split('.').map(|number| number.parse().ok());
    Some([numbers.next()??, numbers.next()??])
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_database_tells_who_wrote_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("database.db");
        assert_eq!(written_by(&file), None);
        for (number, version) in [(4_020_100_u32, Some([4, 2])), (3_130_000, Some([3, 13])), (3_800, None)] {
            let bytes = [&[0; USER_VERSION_AT], &number.to_be_bytes()[..], &[0; 9]].concat();
            fs::write(&file, bytes).unwrap();
            assert_eq!(written_by(&file), version, "{number}");
        }
        fs::write(&file, [9; USER_VERSION_AT]).unwrap();
        assert_eq!(written_by(&file), None);
    }

    #[test]
    fn versions_are_read_as_programs_say_them() {
        assert_eq!(version_in("COLMAP 3.8 (Commit Unknown on Unknown without CUDA)"), Some([3, 8]));
        assert_eq!(version_in("4.2.1"), Some([4, 2]));
        assert_eq!(version_in("3.12.dev0"), Some([3, 12]));
        assert_eq!((version_in("pretended"), version_in("4")), (None, None));
    }
}

//! Rows of an ASCII file: a line each, a word for each property.

use std::io::BufRead;
use std::path::Path;

use super::header::PlyHeader;
use super::{PlyError, read_error, trailing};

/// Passes on the number and the values of each row that `header` promises, in the order of its properties.
pub(super) fn read(
    header: &PlyHeader,
    reader: impl BufRead,
    path: &Path,
    mut on_row: impl FnMut(usize, &[f64]),
) -> Result<(), PlyError> {
    let mut lines = reader.lines();
    let mut values = Vec::with_capacity(header.properties.len());
    for row in 0..header.gaussians as usize {
        let bad = || {
            let problem =
                format!("does not hold one number for each property in row {row}; export the file again");
            PlyError::Rows { path: path.to_owned(), problem }
        };
        let line = lines.next().ok_or_else(bad)?.map_err(|source| read_error(path, source))?;
        let words = line.split_ascii_whitespace().take(header.properties.len());
        values.clear();
        words.map_while(|word| word.parse().ok()).for_each(|value: f64| values.push(value));
        if values.len() < header.properties.len() {
            return Err(bad());
        }
        on_row(row, &values);
    }
    if header.ends_with_vertices && lines.any(|line| !line.is_ok_and(|line| line.trim().is_empty())) {
        return Err(trailing(path, header.gaussians));
    }
    Ok(())
}

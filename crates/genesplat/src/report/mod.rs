//! `report.html`: a run on one page that needs no network and no other file.
//!
//! Everything is inline: styles, curves as SVG, pictures as reduced JPEG in data URIs. Whatever comes from outside
//! (names, paths, settings) passes through [`html::Html`], which escapes it.

pub(crate) mod chart;
pub(crate) mod crops;
pub(crate) mod curves;
pub(crate) mod html;
pub(crate) mod pair;
pub(crate) mod picture;
pub(crate) mod run;
pub(crate) mod sheet;
mod stages;

//! `report.html`: a run on one page that needs no network and no other file.
//!
//! Everything is inline: styles, curves as SVG, pictures as reduced JPEG in data URIs. Whatever comes from
//! outside (names, paths, settings) passes through [`maud`], which escapes it.

pub mod chart;
mod crops;
pub mod curves;
pub mod html;
pub mod pair;
pub mod picture;
pub mod run;
pub mod sheet;
mod stages;
mod timeline;

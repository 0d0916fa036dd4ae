//! `report.html`: a run on one page that needs no network and no other file.
//!
//! Everything is inline: styles, curves as SVG, pictures as JPEG in data URIs, reduced so that a page stays below two
//! MB. Whatever comes from outside (names, paths, settings) passes through [`html::Html`], which escapes it.
//!
//! | module | what it does |
//! |---|---|
//! | [`html`] | markup that is always closed and escaped |
//! | [`curves`] | the log as curves |
//! | [`chart`] | curves as SVG |
//! | [`picture`] | pictures as data URIs, two in one place under a slider, error maps |
//! | [`run`] | the page of one run |
//! | [`stages`] | what evolution did in it, stage by stage |
//! | [`pair`] | the page that compares two runs |
//! | [`crops`], [`sheet`] | where two renders differ most, and the picture that shows it |

pub(crate) mod chart;
pub(crate) mod crops;
pub(crate) mod curves;
pub(crate) mod html;
pub(crate) mod pair;
pub(crate) mod picture;
pub(crate) mod run;
pub(crate) mod sheet;
mod stages;

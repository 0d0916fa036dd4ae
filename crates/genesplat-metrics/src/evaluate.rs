//! Scores of views, and their means.

use genesplat_core::{BackendError, Photo, RenderSettings, Renderer, View};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::lpips::{InputRange, Lpips};
use crate::ssim::ssim_under;
use crate::{SizeMismatch, psnr, psnr_under, ssim};

/// Scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    /// File name of the photo.
    pub name: String,
    /// Peak signal-to-noise ratio, dB; [`crate::PSNR_MAX_DB`] for identical pictures.
    #[serde(deserialize_with = "null_as_nan")]
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// LPIPS as published tables have it; `None` when not measured.
    pub lpips: Option<f64>,
}

/// Means over views, and each view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Mean of the views' PSNR, dB; `null` in JSON when there is no view.
    #[serde(serialize_with = "finite_or_null", deserialize_with = "null_as_nan")]
    pub psnr: f64,
    /// Mean of the views' SSIM; `null` in JSON when there is no view.
    #[serde(serialize_with = "finite_or_null", deserialize_with = "null_as_nan")]
    pub ssim: f64,
    /// Mean of the views' LPIPS; `None` when not measured.
    pub lpips: Option<f64>,
    /// One entry a view, in the order given.
    pub views: Vec<ViewScore>,
}

impl Evaluation {
    /// The means of `views`.
    pub fn from_views(views: Vec<ViewScore>) -> Self {
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
        let lpips: Option<Vec<f64>> = views.iter().map(|view| view.lpips).collect();
        Self {
            psnr: mean(views.iter().map(|view| view.psnr).collect()),
            ssim: mean(views.iter().map(|view| view.ssim).collect()),
            lpips: lpips.filter(|values| !values.is_empty()).map(mean),
            views,
        }
    }
}

/// JSON knows no NaN.
fn finite_or_null<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.is_finite().then_some(*value).serialize(serializer)
}

fn null_as_nan<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Scores of one picture against the truth, without LPIPS.
pub fn compare(name: &str, picture: &Photo, truth: &Photo) -> Result<ViewScore, SizeMismatch> {
    Ok(ViewScore {
        name: name.to_owned(),
        psnr: psnr(picture, truth)?,
        ssim: ssim(picture, truth)?,
        lpips: None,
    })
}

/// Scores of what a device has rendered of `view`, over the pixels that count. LPIPS has no pixels: it sees
/// both pictures black elsewhere, and is left out where they are too small for it.
pub fn score_view(
    view: &View,
    picture: &Photo,
    photo: &Photo,
    lpips: Option<&Lpips>,
) -> Result<ViewScore, SizeMismatch> {
    let mask = view.mask.as_deref();
    let distance = |lpips: &Lpips| {
        lpips.distance(&view.hide_in(picture), &view.hide_in(photo), InputRange::ZeroToOne).ok()
    };
    Ok(ViewScore {
        name: view.name.clone(),
        psnr: psnr_under(mask, picture, photo)?,
        ssim: ssim_under(mask, picture, photo)?,
        lpips: lpips.and_then(distance),
    })
}

/// Renders every view and scores it against its photo; `keep` receives each render (to be saved, say).
///
/// LPIPS is left out where there is no network, and for views that are too small for it.
///
/// # Panics
/// When a view's camera and photo differ in size, which [`View`] rules out.
pub fn evaluate(
    renderer: &mut dyn Renderer,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    mut keep: impl FnMut(&View, Photo),
) -> Result<Evaluation, BackendError> {
    let mut scores = Vec::with_capacity(views.len());
    for view in views {
        let picture = renderer.render(&view.camera, settings)?.to_photo();
        let score = score_view(view, &picture, &*view.photo.read()?, lpips);
        scores.push(score.expect("a view's camera has the size of its photo"));
        keep(view, picture);
    }
    Ok(Evaluation::from_views(scores))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Mask, Rng, Stream};

    use super::*;
    use crate::lpips::Net;
    use crate::weights::Tensor;

    fn score(psnr: f64, lpips: Option<f64>) -> ViewScore {
        ViewScore { name: "a.png".into(), psnr, ssim: 0.5, lpips }
    }

    #[test]
    fn means_are_over_views() {
        let evaluation = Evaluation::from_views(vec![score(20.0, Some(0.1)), score(30.0, Some(0.3))]);
        assert_eq!((evaluation.psnr, evaluation.ssim, evaluation.lpips), (25.0, 0.5, Some(0.2)));
        assert_eq!(Evaluation::from_views(vec![score(20.0, Some(0.1)), score(30.0, None)]).lpips, None);
        assert_eq!(Evaluation::from_views(Vec::new()).lpips, None);
    }

    #[test]
    fn lpips_does_not_see_what_a_mask_hides() {
        let value = |i: usize| Rng::new(3).at(Stream::Test, 0, i as u32, 0).uniform(0) - 0.5;
        let tensor =
            |shape: Vec<usize>| Tensor { values: (0..shape.iter().product()).map(value).collect(), shape };
        let tensors = Net::AlexNet.tensors().map(|(name, shape)| (name, tensor(shape))).collect();
        let lpips = Lpips::new(Net::AlexNet, &tensors).unwrap();
        let columns =
            |right: u8| (0..32 * 32).flat_map(|i| [if i % 32 < 16 { 99 } else { right }; 3]).collect();
        let photo = |right: u8| Photo { width: 32, height: 32, rgb: columns(right) };
        let distance = |mask: Option<Mask>| {
            let (name, camera) = ("a.png".into(), Camera::at_origin(32, 32, 32.0));
            let view = View { name, camera, photo: photo(0).into(), mask: mask.map(Arc::new), depth: None };
            score_view(&view, &photo(255), &photo(0), Some(&lpips)).unwrap().lpips.unwrap()
        };
        assert!(distance(None) != 0.0);
        assert_eq!(distance(Some(Mask { counts: (0..32 * 32).map(|i| i % 32 < 16).collect() })), 0.0);
    }

    #[test]
    fn what_json_cannot_say_becomes_null() {
        let none = serde_json::to_value(Evaluation::from_views(Vec::new())).unwrap();
        assert!(none["psnr"].is_null() && none["ssim"].is_null());
        let read: Evaluation = serde_json::from_value(none).unwrap();
        assert!(read.psnr.is_nan() && read.ssim.is_nan());
    }

    #[test]
    fn a_view_that_is_reproduced_exactly_has_a_figure() {
        let photo = Photo { width: 16, height: 16, rgb: vec![77; 3 * 16 * 16] };
        let exact = Evaluation::from_views(vec![compare("a.png", &photo, &photo).unwrap()]);
        let json = serde_json::to_value(&exact).unwrap();
        assert_eq!((&json["psnr"], &json["views"][0]["psnr"]), (&120.0.into(), &120.0.into()));
        // Older versions wrote `null`.
        let older: ViewScore =
            serde_json::from_str(r#"{"name": "a.png", "psnr": null, "ssim": 1.0}"#).unwrap();
        assert!(older.psnr.is_nan());
    }
}

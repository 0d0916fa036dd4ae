//! Evaluation renders each view, in order, and hands the pictures on.

use genesplat_core::RenderSettings;
use genesplat_metrics::{PSNR_MAX_DB, evaluate};

use crate::support::{FakeBackend, views};

#[test]
fn each_view_is_rendered_scored_and_kept() {
    // The backend renders black; the second photo is white instead.
    let mut views = views(3);
    let mut white = (*views[1].photo.read().unwrap()).clone();
    white.rgb.fill(255);
    views[1].photo = white.into();
    let (mut kept, settings) = (Vec::new(), RenderSettings::default());
    let evaluation = evaluate(&mut FakeBackend::new(), &views, &settings, None, |view, picture| {
        kept.push((view.name.clone(), picture.rgb[0]));
    })
    .unwrap();
    let names = ["000.png", "001.png", "002.png"];
    assert_eq!(kept, names.map(|name| (name.to_owned(), 0)));
    let psnr: Vec<f64> = evaluation.views.iter().map(|view| view.psnr).collect();
    assert_eq!(psnr, [PSNR_MAX_DB, 0.0, PSNR_MAX_DB]);
    assert_eq!(evaluation.views[0].ssim, 1.0);
    assert!(evaluation.views[1].ssim < 0.01, "{}", evaluation.views[1].ssim);
    assert_eq!((evaluation.psnr, evaluation.lpips), (PSNR_MAX_DB * 2.0 / 3.0, None));
}

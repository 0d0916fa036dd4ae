//! How far off the depths are that a cloud shows.

use genesplat_core::{BackendError, DepthMap, RenderSettings, Renderer, View};

/// A depth is off by all of it where the cloud covers less of the pixel than this: nothing is there.
const COVERED: f32 = 0.5;

/// The mean over all pixels whose depth is known of `|z' / z - 1|`, at most 1, of a depth `z'` that is the
/// inverse of the mean inverse depth that the cloud shows there; `None` where the view has no depth map.
pub fn depth_error(
    renderer: &mut dyn Renderer,
    view: &View,
    settings: &RenderSettings,
) -> Result<Option<f64>, BackendError> {
    let Some(DepthMap { nearest, .. }) = view.depth else { return Ok(None) };
    let picture = renderer.render(&view.camera, &settings.of_inverse_depth(nearest))?;
    let known = view.depth.as_ref().map(DepthMap::inverse).transpose()?.unwrap_or_default();
    let (inverse, others) = picture.planes.split_at(known.len());
    let off = |((&inverse, &covered), &known): ((&f32, &f32), &f32)| {
        if covered < COVERED { 1.0 } else { f64::from((covered * known / inverse - 1.0).abs()).min(1.0) }
    };
    let errors: Vec<f64> =
        inverse.iter().zip(others).zip(&known).filter(|(_, known)| **known > 0.0).map(off).collect();
    Ok(if errors.is_empty() { None } else { Some(errors.iter().sum::<f64>() / errors.len() as f64) })
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use genesplat_core::{Camera, Gaussians, Image, Photo};

    use super::*;

    /// Shows the same inverse depth and coverage everywhere.
    struct Wall([f32; 2]);

    impl Renderer for Wall {
        fn describe(&self) -> String {
            "a wall".into()
        }

        fn gaussian_count(&self) -> usize {
            0
        }

        fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
            unreachable!("nobody asks for the wall")
        }

        fn render(&mut self, camera: &Camera, _: &RenderSettings) -> Result<Image, BackendError> {
            let pixels = (camera.width * camera.height) as usize;
            let [inverse, covered] = self.0.map(|value| vec![value; pixels]);
            let planes = [inverse, covered, vec![0.0; pixels]].concat();
            Ok(Image { width: camera.width, height: camera.height, planes })
        }
    }

    #[test]
    fn what_is_off_is_told_where_the_depth_is_known() {
        // Nearest 2; a third is not known.
        let depths = [2.0, 4.0, 0.0, 4.0, 4.0, 0.0];
        let (codes, nearest) = DepthMap::encode(&depths, 3, 2).unwrap();
        let photo = Photo { width: 3, height: 2, rgb: vec![0; 18] }.into();
        let depth = Some(DepthMap { codes: codes.into(), nearest });
        let view = View { name: "a".into(), camera: Camera::at_origin(3, 2, 3.0), photo, mask: None, depth };
        let settings = RenderSettings::default();
        let error = |wall| depth_error(&mut Wall(wall), &view, &settings).unwrap().unwrap();
        // A wall at 4, in front of which something is at 2: twice as far.
        assert!((error([0.5, 1.0]) - 0.25).abs() < 1e-4);
        // Half covered, it is where it is.
        assert!((error([0.25, 0.5]) - 0.25).abs() < 1e-4);
        assert_eq!(error([0.2, 0.4]), 1.0);
        assert_eq!(error([0.0, 1.0]), 1.0, "at infinity");
        let without = View { depth: None, ..view.clone() };
        assert_eq!(depth_error(&mut Wall([0.5, 1.0]), &without, &settings).unwrap(), None);
    }
}

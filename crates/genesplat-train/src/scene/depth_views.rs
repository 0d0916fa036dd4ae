//! Depth maps as views: what a look at how far away things are compares.
//!
//! A look renders inverse depth where a photo was taken, and its gradients go into the next step (the loss of
//! Kerbl et al.'s depth regularisation, which blends inverse depth as a fourth colour). Inverse depths are
//! told in those of the whole scene, so that a weight means the same in every scene and photo.

use genesplat_core::{DepthMap, PhotoLost, Rng, View, median};

use super::views::ViewOrder;

/// They are visited in an order of their own.
const ORDER: u32 = u32::from_be_bytes(*b"dept");

/// One in so many pixels tells how far away a map is: the median does not need all of them.
const LOOKED_AT: usize = 61;

/// The depth maps of a run.
pub(crate) struct DepthViews {
    views: Vec<View>,
    /// What makes inverse depths of each map those of the scene.
    looks: Vec<DepthLook>,
    order: ViewOrder,
}

/// A look at one of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DepthLook {
    /// Its place among them.
    pub(crate) view: usize,
    /// The depth that is 1, world units.
    pub(crate) nearest: f32,
    /// The median depth of the scene, in those.
    pub(crate) scale: f32,
}

impl DepthViews {
    pub(crate) fn new(photos: &[View], rng: Rng) -> Result<Self, PhotoLost> {
        let with_map = photos.iter().filter_map(|view| view.depth.as_ref().map(|map| (view, map)));
        let (views, maps): (Vec<View>, Vec<&DepthMap>) = with_map
            .map(|(view, map)| {
                let view = View { photo: map.codes.clone(), mask: None, depth: None, ..view.clone() };
                (view, map)
            })
            .unzip();
        let depths = maps.iter().map(|map| median_depth(map)).collect::<Result<Vec<_>, _>>()?;
        let of_scene = median(depths.into_iter().flatten()).unwrap_or(1.0);
        let look = |(view, map): (usize, &&DepthMap)| {
            let scale = (of_scene / f64::from(map.nearest)) as f32;
            DepthLook { view, nearest: map.nearest, scale }
        };
        let looks: Vec<DepthLook> = maps.iter().enumerate().map(look).collect();
        Ok(Self { order: ViewOrder::new(rng.fork(ORDER), views.len()), views, looks })
    }

    /// As a device has them.
    pub(crate) fn views(&self) -> &[View] {
        &self.views
    }

    /// The `visit`-th look, counted from 0; `None` where there is no map.
    pub(crate) fn look(&mut self, visit: u32) -> Option<DepthLook> {
        (!self.looks.is_empty()).then(|| self.looks[self.order.view(visit)])
    }
}

/// The median depth that a map knows, world units.
fn median_depth(map: &DepthMap) -> Result<Option<f64>, PhotoLost> {
    let known = map.inverse()?.into_iter().step_by(LOOKED_AT).filter(|&inverse| inverse > 0.0);
    Ok(median(known.map(f64::from)).map(|inverse| f64::from(map.nearest) / inverse))
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Camera, Photo};

    use super::*;

    fn view(depth: Option<f32>) -> View {
        let depth = depth.map(|depth| {
            let mut depths = vec![depth; 200];
            depths[0] = 1.0;
            let (codes, nearest) = DepthMap::encode(&depths, 20, 10).unwrap();
            DepthMap { codes: codes.into(), nearest }
        });
        let photo = Photo { width: 20, height: 10, rgb: vec![9; 600] }.into();
        let camera = Camera::at_origin(20, 10, 10.0);
        View { name: "a".into(), camera, photo, mask: None, depth }
    }

    #[test]
    fn maps_are_told_in_the_depth_of_the_scene() {
        let photos = [view(Some(4.0)), view(None), view(Some(2.0)), view(Some(8.0))];
        let mut depths = DepthViews::new(&photos, Rng::new(1)).unwrap();
        assert_eq!(depths.views().len(), 3);
        let mut looks: Vec<DepthLook> = (0..3).map(|visit| depths.look(visit).unwrap()).collect();
        looks.sort_by_key(|look| look.view);
        for (place, look) in looks.iter().enumerate() {
            assert_eq!((look.view, look.nearest), (place, 1.0));
            assert!((look.scale - 4.0).abs() < 1e-3, "{look:?}");
        }
        assert!(DepthViews::new(&photos[1..2], Rng::new(1)).unwrap().look(0).is_none());
    }
}

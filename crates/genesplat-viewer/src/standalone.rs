//! A page to send: one file that holds a splat and draws it, without a server and without a network.
//!
//! The splat is carried as `.spz` of version 3, whose gzip browsers undo by themselves. A page from the disk
//! may load no modules, so they are data in its import map; and its own policy forbids it all connections.
//!
//! The page is in the frame of `.spz`, y up and z back: half a turn about x from the cloud's own.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use genesplat_core::constants::NEAR_DEPTH;
use genesplat_core::{Camera, Photo, RenderSettings, ScreenFilter};
use serde::Serialize;

use crate::framing::Framing;
use crate::message::Pose;
use crate::picture::encode_jpeg;
use crate::scene_views::Split;

const PAGE: &str = include_str!("../standalone/index.html");
const STYLE: &str = include_str!("../standalone/style.css");
const ICON: &str = include_str!("../page/icon.svg");
const SORTER: &str = include_str!("../standalone/sorter.js");
/// Modules by the names that they import each other by; three are the live page's.
const MODULES: [(&str, &str); 9] = [
    ("cameras.js", include_str!("../page/cameras.js")),
    ("navigation.js", include_str!("../page/navigation.js")),
    ("vector.js", include_str!("../page/vector.js")),
    ("journey.js", include_str!("../standalone/journey.js")),
    ("main.js", include_str!("../standalone/main.js")),
    ("renderer.js", include_str!("../standalone/renderer.js")),
    ("shaders.js", include_str!("../standalone/shaders.js")),
    ("spz.js", include_str!("../standalone/spz.js")),
    ("stage.js", include_str!("../standalone/stage.js")),
];

/// Longest side of a thumbnail, px.
const THUMBNAIL_PX: u32 = 176;
const THUMBNAIL_QUALITY: u8 = 80;

/// What a page shows.
#[derive(Clone, Copy, Debug)]
pub struct Standalone<'a> {
    /// What it is called.
    pub title: &'a str,
    /// The splat as `.spz` of version 3.
    pub spz: &'a [u8],
    /// How many Gaussians it has.
    pub gaussians: usize,
    /// How it is drawn.
    pub settings: &'a RenderSettings,
    /// Which way is up, and what to turn around, in the frame of the cloud.
    pub framing: Framing,
    /// Cameras to jump to.
    pub shots: &'a [Shot],
}

/// A camera to jump to.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Name of its photo.
    pub name: String,
    /// What its photo was for.
    pub split: Split,
    /// In the frame of the cloud.
    pub camera: Camera,
    /// What it sees, small ([`thumbnail_camera`]).
    pub thumbnail: Photo,
}

#[derive(Serialize)]
struct Scene<'a> {
    gaussians: usize,
    #[serde(flatten)]
    framing: Framing,
    background: [f32; 3],
    dilation: f32,
    filter: &'static str,
    near: f64,
    cameras: Vec<Card<'a>>,
}

#[derive(Serialize)]
struct Card<'a> {
    name: &'a str,
    split: Split,
    width: u32,
    height: u32,
    focal: [f64; 2],
    principal: [f64; 2],
    #[serde(flatten)]
    pose: Pose,
    thumbnail: String,
}

/// The camera that sees what a thumbnail shows.
pub fn thumbnail_camera(camera: &Camera) -> Camera {
    let factor = f64::from(THUMBNAIL_PX) / f64::from(camera.width.max(camera.height));
    let [width, height] =
        [camera.width, camera.height].map(|side| (f64::from(side) * factor.min(1.0)).round() as u32);
    camera.resized(width.max(1), height.max(1))
}

impl Standalone<'_> {
    /// The whole file.
    pub fn html(&self) -> String {
        let [red, green, blue] = self.settings.background.map(|value| (255.0 * value).round());
        fill(
            PAGE,
            &[
                ("title", &escaped(self.title)),
                ("style", STYLE),
                ("icon", &STANDARD.encode(ICON)),
                ("background", &format!("rgb({red} {green} {blue})")),
                ("modules", &modules()),
                // A tag cannot end in what has no "<".
                ("scene", &json(&self.scene()).replace('<', "\\u003c")),
                ("sorter", SORTER),
                ("splat", &STANDARD.encode(self.spz)),
            ],
        )
    }

    fn scene(&self) -> Scene<'_> {
        let Framing { up, centre, distance } = self.framing;
        Scene {
            gaussians: self.gaussians,
            framing: Framing { up: turned(up), centre: turned(centre), distance },
            background: self.settings.background,
            dilation: self.settings.filter.dilation(),
            filter: match self.settings.filter {
                ScreenFilter::Classic => "classic",
                ScreenFilter::Antialiased => "antialiased",
                ScreenFilter::Mip => "mip",
            },
            near: self.shots.first().map_or(NEAR_DEPTH.min(0.1 * distance), |shot| shot.camera.near),
            cameras: self.shots.iter().map(Card::of).collect(),
        }
    }
}

impl<'a> Card<'a> {
    fn of(shot: &'a Shot) -> Self {
        let Shot { name, split, camera, thumbnail } = shot;
        let Pose { position, rotation: [w, x, y, z], fov_y } = Pose::of(camera);
        Self {
            name,
            split: *split,
            width: camera.width,
            height: camera.height,
            focal: camera.focal_px,
            principal: camera.principal_px,
            // The half turn times the rotation.
            pose: Pose { position: turned(position), rotation: [-x, w, -z, y], fov_y },
            thumbnail: data("image/jpeg", &encode_jpeg(thumbnail, THUMBNAIL_QUALITY)),
        }
    }
}

/// By half a turn about x.
fn turned([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

/// The import map. Modules that are data have no place from which "./" could lead anywhere, so they go by
/// bare names.
fn modules() -> String {
    let address = |source: &str| data("text/javascript", source.replace("from \"./", "from \"").as_bytes());
    let imports: serde_json::Map<_, _> =
        MODULES.iter().map(|(name, source)| ((*name).to_owned(), address(source).into())).collect();
    json(&serde_json::json!({ "imports": imports }))
}

fn data(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", STANDARD.encode(bytes))
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("plain data with text keys is always JSON")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// `template` with a value for each `{name}`, and nothing else: what is in a value stays as it is.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut filled =
        String::with_capacity(template.len() + values.iter().map(|(_, value)| value.len()).sum::<usize>());
    let mut parts = template.split('{');
    filled += parts.next().unwrap_or_default();
    for part in parts {
        let (name, rest) = part.split_once('}').expect("a placeholder has an end");
        let value = values.iter().find(|(known, _)| *known == name);
        filled += value.unwrap_or_else(|| panic!("a value for {name}")).1;
        filled += rest;
    }
    filled
}

#[cfg(test)]
mod tests {
    use genesplat_core::Gaussians;
    use glam::{DQuat, DVec3};

    use super::*;

    fn page(title: &str) -> String {
        let camera = Camera {
            focal_px: [300.0, 310.0],
            principal_px: [150.0, 110.0],
            camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.9),
            camera_from_world_translation: DVec3::new(1.0, -2.0, 3.0),
            near: 0.004,
            ..Camera::at_origin(320, 200, 300.0)
        };
        let small = thumbnail_camera(&camera);
        assert_eq!((small.width, small.height), (176, 110));
        let thumbnail = Photo { width: 176, height: 110, rgb: vec![90; 3 * 176 * 110] };
        let shot = Shot { name: "</script>.jpg".into(), split: Split::Test, camera, thumbnail };
        let framing = Framing::of_cloud(&Gaussians::zeros(1));
        let settings = RenderSettings::default();
        let shots = [shot];
        Standalone { title, spz: b"bytes", gaussians: 1, settings: &settings, framing, shots: &shots }.html()
    }

    #[test]
    fn names_of_strangers_stay_text() {
        let page = page("<b>{splat} & \"");
        assert!(page.contains("<title>&lt;b>{splat} &amp; &quot;</title>"));
        assert!(page.contains("\\u003c/script>.jpg"));
        assert_eq!(page.matches("</script>").count(), page.matches("<script").count());
        assert_eq!(page.matches(&STANDARD.encode("bytes")).count(), 1);
    }

    #[test]
    fn the_page_loads_nothing_and_every_module_is_there() {
        let page = page("a");
        let addresses = ["http", "//www", "src=", "url(", "fetch(", "XMLHttpRequest", "WebSocket"];
        let sources = MODULES.iter().map(|(_, source)| *source).chain([page.as_str(), SORTER, STYLE]);
        for source in sources {
            let plain = source.replace("http-equiv", "");
            assert_eq!(addresses.iter().find(|word| plain.contains(**word)), None);
            for name in source.split("from \"./").skip(1).filter_map(|rest| rest.split('"').next()) {
                assert!(MODULES.iter().any(|(module, _)| *module == name), "{name}");
            }
        }
    }

    #[test]
    fn the_page_is_half_a_turn_about_x_from_the_cloud() {
        let page = page("a");
        let scene =
            page.split("id=\"scene\">").nth(1).and_then(|rest| rest.split("</script>").next()).unwrap();
        let scene: serde_json::Value = serde_json::from_str(scene).unwrap();
        assert_eq!(scene["up"], serde_json::json!([0.0, 1.0, 0.0]));
        assert_eq!(scene["near"], 0.004, "as its cameras have it");
        let pose: Pose = serde_json::from_value(scene["cameras"][0].clone()).unwrap();
        let camera = pose.camera(320, 200);
        // A point of the cloud, and the same in the page, are seen in the same place.
        let expected = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.9) * DVec3::new(0.5, 0.7, -0.9)
            + DVec3::new(1.0, -2.0, 3.0);
        assert!(camera.camera_from_world(DVec3::new(0.5, -0.7, 0.9)).distance(expected) < 1e-12);
    }
}

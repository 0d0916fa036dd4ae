//! What page and server say to each other: JSON both ways, and pictures as JPEG behind a JSON header.
//!
//! Whatever comes from a page is checked here once: sizes, finite numbers, a rotation that is one.

use genesplat_core::Camera;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::edit::{Crop, Stroke};
use crate::render_mode::RenderMode;

/// Longest message of a page, bytes: a stroke of a brush has some hundred points.
pub const MESSAGE_BYTES_MAX: usize = 8192;
/// Sides of a picture that may be asked for, px.
pub const SIDE_PX: std::ops::RangeInclusive<u32> = 16..=4096;
/// Most pixels of a picture.
pub const PIXELS_MAX: u32 = 4096 * 2304;
/// JPEG qualities that may be asked for.
pub const QUALITY: std::ops::RangeInclusive<u8> = 10..=95;
/// Vertical fields of view, radians.
pub const FOV_Y: std::ops::RangeInclusive<f64> = 0.02..=2.8;
/// Farthest that a page may go, world units.
const COORDINATE_MAX: f64 = 1e9;

/// What a page wants.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ClientMessage {
    /// A picture, instead of all that it asked for before.
    Look(Look),
    /// Training shall wait.
    Pause,
    /// Training shall go on.
    Resume,
    /// The cloud as it is shall be saved.
    Snapshot,
    /// The run shall end here, and be saved.
    Stop,
    /// What is in a box, or all else, shall go.
    Crop(Crop),
    /// What is under a brush shall go.
    Erase(Stroke),
    /// The last edit shall be as if it had not been.
    Undo,
    /// The edited splat shall be saved.
    Save,
}

/// A picture that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Look {
    /// The page's own count; its picture carries it.
    pub sequence: u32,
    /// From where; of a scene's camera this is ignored.
    pub pose: Pose,
    /// Index of the scene's camera to look through, with its own focal lengths.
    #[serde(default)]
    pub camera: Option<u32>,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// What is shown.
    #[serde(default)]
    pub render_mode: RenderMode,
    /// Of the JPEG.
    pub quality: u8,
    /// Also where the picture differs from the camera's photo.
    #[serde(default)]
    pub error: bool,
}

/// Where a page looks from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Centre of the camera, world units.
    pub position: [f64; 3],
    /// `world_from_camera` as a quaternion `(w, x, y, z)`; camera axes are x right, y down, z forward.
    pub rotation: [f64; 4],
    /// Vertical field of view, radians.
    pub fov_y: f64,
}

/// Why a message is refused.
#[derive(Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MessageError {
    /// It is too long to be read.
    #[error("a message has at most {MESSAGE_BYTES_MAX} bytes")]
    TooLong,
    /// It is none of ours.
    #[error("not a message of the page: {0}")]
    Json(String),
    /// A number that no page sends.
    #[error("{0} is out of range")]
    Range(&'static str),
}

impl ClientMessage {
    /// Reads a message from the bytes of a stranger.
    pub fn parse(bytes: &[u8]) -> Result<Self, MessageError> {
        if bytes.len() > MESSAGE_BYTES_MAX {
            return Err(MessageError::TooLong);
        }
        let read = serde_json::from_slice(bytes);
        let message: Self = read.map_err(|error| MessageError::Json(error.to_string()))?;
        message.check()?;
        Ok(message)
    }

    fn check(&self) -> Result<(), MessageError> {
        match self {
            Self::Look(look) => look.check(),
            Self::Crop(crop) => crop.check(),
            Self::Erase(stroke) => stroke.check(),
            Self::Pause | Self::Resume | Self::Snapshot | Self::Stop | Self::Undo | Self::Save => Ok(()),
        }
    }
}

pub(crate) fn check_size(width: u32, height: u32) -> Result<(), MessageError> {
    let is_size = SIDE_PX.contains(&width) && SIDE_PX.contains(&height) && width * height <= PIXELS_MAX;
    if is_size { Ok(()) } else { Err(MessageError::Range("the size")) }
}

/// Numbers that are not finite are not near, either.
pub(crate) fn check_place(place: &[f64; 3], what: &'static str) -> Result<(), MessageError> {
    let is_near = place.iter().all(|value| value.abs() <= COORDINATE_MAX);
    if is_near { Ok(()) } else { Err(MessageError::Range(what)) }
}

pub(crate) fn check_rotation(rotation: &[f64; 4]) -> Result<(), MessageError> {
    let norm = rotation.iter().map(|value| value * value).sum::<f64>();
    if (0.25..=4.0).contains(&norm) { Ok(()) } else { Err(MessageError::Range("the rotation")) }
}

impl Look {
    fn check(&self) -> Result<(), MessageError> {
        check_size(self.width, self.height)?;
        match QUALITY.contains(&self.quality) {
            true => self.pose.check(),
            false => Err(MessageError::Range("the quality")),
        }
    }
}

impl Pose {
    pub(crate) fn check(&self) -> Result<(), MessageError> {
        check_place(&self.position, "the position")?;
        check_rotation(&self.rotation)?;
        match FOV_Y.contains(&self.fov_y) {
            true => Ok(()),
            false => Err(MessageError::Range("the field of view")),
        }
    }

    pub(crate) fn is_sound(&self) -> bool {
        self.check().is_ok()
    }

    /// The camera of this pose with square pixels and its principal point in the middle.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        let [w, x, y, z] = self.rotation;
        let camera_from_world_rotation = DQuat::from_xyzw(x, y, z, w).normalize().conjugate();
        let focal_px = 0.5 * f64::from(height) / (0.5 * self.fov_y).tan();
        Camera {
            camera_from_world_rotation,
            camera_from_world_translation: -(camera_from_world_rotation * DVec3::from(self.position)),
            ..Camera::at_origin(width, height, focal_px)
        }
    }

    /// Where `camera` is, and how much of the height it sees.
    pub fn of(camera: &Camera) -> Self {
        let rotation = camera.camera_from_world_rotation.normalize().conjugate();
        Self {
            position: camera.centre_in_world().into(),
            rotation: [rotation.w, rotation.x, rotation.y, rotation.z],
            fov_y: 2.0 * camera.tan_half_fov()[1].atan(),
        }
    }
}

#[derive(Serialize)]
#[serde(tag = "type", rename = "notice")]
struct Notice<'a> {
    text: &'a str,
}

/// A sentence that a page shows.
pub(crate) fn notice(text: &str) -> String {
    serde_json::to_string(&Notice { text }).expect("plain data with text keys is always JSON")
}

/// What stands before a picture: its length as four bytes, little end first, then this as JSON, then the
/// JPEG.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PictureHeader {
    /// Of the [`Look`] that asked for it.
    pub sequence: u32,
    /// True for where picture and photo differ.
    pub error: bool,
    /// What the ends of the colour scale mean, where there is one.
    pub range: Option<[f32; 2]>,
    /// What rendering took.
    pub milliseconds: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOK: &str = r#"{"type":"look","sequence":7,"pose":{"position":[1,2,3],"rotation":[1,0,0,0],"fov_y":1},
        "width":320,"height":200,"quality":70,"render_mode":"depth"}"#;

    #[test]
    fn a_look_is_read_and_what_no_page_sends_is_refused() {
        let Ok(ClientMessage::Look(look)) = ClientMessage::parse(LOOK.as_bytes()) else { panic!("{LOOK}") };
        assert_eq!(
            (look.sequence, look.camera, look.render_mode, look.error),
            (7, None, RenderMode::Depth, false)
        );
        let spoilt = [
            ("320", "8", "the size"),
            ("320", "5000", "the size"),
            (":70", ":0", "the quality"),
            ("[1,2,3]", "[1,2,1e300]", "the position"),
            ("[1,0,0,0]", "[0,0,0,0]", "the rotation"),
            (":1}", ":3.2}", "the field of view"),
        ];
        for (good, bad, what) in spoilt {
            let text = LOOK.replacen(good, bad, 1);
            assert_eq!(ClientMessage::parse(text.as_bytes()), Err(MessageError::Range(what)), "{text}");
        }
        assert_eq!(ClientMessage::parse(&[b' '; MESSAGE_BYTES_MAX + 1]), Err(MessageError::TooLong));
        for garbage in [&b"\xff\xfe"[..], b"", b"{}", b"[[[[", br#"{"type":"open","path":"/etc/passwd"}"#] {
            assert!(matches!(ClientMessage::parse(garbage), Err(MessageError::Json(_))));
        }
        let unknown = LOOK.replacen("render_mode", "lens", 1);
        assert!(matches!(ClientMessage::parse(unknown.as_bytes()), Err(MessageError::Json(_))), "{unknown}");
        assert_eq!(ClientMessage::parse(br#"{"type":"pause"}"#), Ok(ClientMessage::Pause));
    }

    #[test]
    fn edits_are_read_and_what_no_page_sends_is_refused() {
        let crop = r#"{"type":"crop","centre":[0,0,0],"rotation":[1,0,0,0],"half_sizes":[1,2,3],"removes":"outside"}"#;
        let erase = r#"{"type":"erase","pose":{"position":[1,2,3],"rotation":[1,0,0,0],"fov_y":1},
            "width":320,"height":200,"radius":20,"path":[[1,2],[3,4]]}"#;
        let parse = |text: &str| ClientMessage::parse(text.as_bytes());
        assert!(matches!(parse(crop), Ok(ClientMessage::Crop(crop)) if crop.half_sizes == [1.0, 2.0, 3.0]));
        assert!(matches!(parse(erase), Ok(ClientMessage::Erase(stroke)) if !stroke.through));
        assert_eq!(parse(r#"{"type":"undo"}"#), Ok(ClientMessage::Undo));
        let long = format!("[[1,2]{}]", ",[3,4]".repeat(crate::edit::STROKE_POINTS_MAX));
        for (text, good, bad, what) in [
            (crop, "[1,2,3]", "[1,0,3]", "the size of the box"),
            (crop, "[0,0,0]", "[0,0,2e9]", "the middle of the box"),
            (crop, "[1,0,0,0]", "[3,0,0,0]", "the rotation"),
            (erase, ":320", ":5", "the size"),
            (erase, ":20,", ":0.5,", "the radius of the brush"),
            (erase, "[[1,2],[3,4]]", "[]", "the length of the stroke"),
            (erase, "[[1,2],[3,4]]", &long, "the length of the stroke"),
            (erase, "[3,4]", "[3,1e6]", "a point of the stroke"),
            (erase, ":1}", ":9}", "the field of view"),
        ] {
            let spoilt = text.replacen(good, bad, 1);
            assert_eq!(parse(&spoilt), Err(MessageError::Range(what)), "{spoilt}");
        }
    }

    #[test]
    fn a_pose_becomes_its_camera_and_back() {
        let pose = Pose { position: [1.0, -2.0, 3.0], rotation: [0.5, 0.5, -0.5, 0.5], fov_y: 0.8 };
        let back = Pose::of(&pose.camera(300, 200));
        let numbers = |pose: Pose| [&pose.position[..], &pose.rotation, &[pose.fov_y]].concat();
        for (value, expected) in numbers(back).iter().zip(numbers(pose)) {
            assert!((value - expected).abs() < 1e-12, "{back:?}");
        }
        let centre = pose.camera(300, 200).camera_from_world(DVec3::from(pose.position));
        assert!(centre.length() < 1e-12);
    }
}

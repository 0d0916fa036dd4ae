//! COLMAP's camera models: what the parameters of each are.
//!
//! Source: COLMAP's documentation of its camera models, and `sensor/models.h` for the order.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use super::check::bad_camera;
use crate::error::SceneError;
use crate::listing::coefficients_problem;
use crate::photos::{Lens, Polynomial, Projection};

/// That of photos of all around: it has a width and a height, px, and no focal length.
pub(crate) const ROUND: &str = "EQUIRECTANGULAR";

/// Names by id, and how many parameters each has.
pub(super) const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    (ROUND, 2),
];

/// `[fx, fy, cx, cy]` and the lens of a camera with these parameters.
pub(super) fn parameters(
    file: &Path,
    camera: u32,
    model: &str,
    parameters: &[f64],
) -> Result<([f64; 4], Option<Lens>), SceneError> {
    let Some(&(_, count)) = MODELS.iter().find(|(name, _)| *name == model) else {
        return Err(SceneError::DistortedCamera { file: file.to_owned(), camera, model: model.to_owned() });
    };
    if parameters.len() != count {
        let given = parameters.len();
        let problem = format!(
            "camera {camera} has {given} parameters, and {model} has {count}; copy or export the file again"
        );
        return Err(SceneError::bad_record(file, problem));
    }
    let (pinhole, coefficients) = pinhole_and_rest(model, parameters);
    if let Some(problem) = coefficients_problem(coefficients) {
        return Err(bad_camera(file, camera, problem));
    }
    let lens =
        Lens { projection: projection(model, coefficients), polynomial: polynomial(model, coefficients) };
    Ok((pinhole, (!lens.is_pinhole()).then_some(lens)))
}

/// Models have one focal length or two, then the principal point, then what bends.
fn pinhole_and_rest<'a>(model: &str, parameters: &'a [f64]) -> ([f64; 4], &'a [f64]) {
    let has_one_focal = model.starts_with("SIMPLE_") || model.starts_with("RADIAL");
    match *parameters {
        [width, height] => (round(width, height), &[]),
        [f, cx, cy, ref rest @ ..] if has_one_focal => ([f, f, cx, cy], rest),
        [fx, fy, cx, cy, ref rest @ ..] => ([fx, fy, cx, cy], rest),
        _ => {
            unreachable!("every model but one has at least three parameters, and four with two focal lengths")
        }
    }
}

/// `[fx, fy, cx, cy]` of photos of all around: pixels for a radian, and where what is ahead lies.
pub(crate) fn round(width: f64, height: f64) -> [f64; 4] {
    [width / TAU, height / PI, 0.5 * width, 0.5 * height]
}

fn projection(model: &str, coefficients: &[f64]) -> Projection {
    match (model, coefficients) {
        (ROUND, _) => Projection::Equirectangular,
        ("FOV", &[omega]) => Projection::FieldOfView { omega },
        ("SIMPLE_DIVISION" | "DIVISION", &[k]) => Projection::Division { k },
        ("EUCM", &[alpha, beta]) => Projection::EnhancedUnified { alpha, beta },
        _ if model.ends_with("FISHEYE") => Projection::Fisheye,
        _ => Projection::Perspective,
    }
}

fn polynomial(model: &str, coefficients: &[f64]) -> Polynomial {
    let none = Polynomial::default();
    let radial = |k: &[f64]| [0, 1, 2, 3, 4, 5].map(|index| k.get(index).copied().unwrap_or(0.0));
    match (model, coefficients) {
        ("FOV" | "SIMPLE_DIVISION" | "DIVISION" | "EUCM", _) => none,
        ("OPENCV", &[k1, k2, p1, p2]) => {
            Polynomial { radial: radial(&[k1, k2]), tangential: [p1, p2], ..none }
        }
        ("FULL_OPENCV", &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
            Polynomial { radial: radial(&[k1, k2, k3]), divisor: [k4, k5, k6], tangential: [p1, p2], ..none }
        }
        ("THIN_PRISM_FISHEYE", &[k1, k2, p1, p2, k3, k4, sx, sy]) => Polynomial {
            radial: radial(&[k1, k2, k3, k4]),
            tangential: [p1, p2],
            prism: [[sx, 0.0], [sy, 0.0]],
            ..none
        },
        // Its p0 is OpenCV's p2.
        ("RAD_TAN_THIN_PRISM_FISHEYE", &[ref k @ .., p0, p1, s0, s1, s2, s3]) => Polynomial {
            radial: radial(k),
            tangential: [p1, p0],
            prism: [[s0, s1], [s2, s3]],
            radial_first: true,
            ..none
        },
        (_, k) => Polynomial { radial: radial(k), ..none },
    }
}

/// The model that says what `lens` says, and its coefficients after focal lengths and principal point; `None`
/// where COLMAP has none. It has two focal lengths.
pub(super) fn of_lens(lens: Option<&Lens>) -> Option<(&'static str, Vec<f64>)> {
    let Some(lens) = lens else { return Some(("PINHOLE", Vec::new())) };
    let Polynomial { radial: k, divisor: d, tangential: [p1, p2], prism: [[s0, s1], [s2, s3]], .. } =
        lens.polynomial;
    let (name, coefficients) = match lens.projection {
        Projection::Equirectangular => (ROUND, Vec::new()),
        Projection::FieldOfView { omega } => ("FOV", vec![omega]),
        Projection::Division { k } => ("DIVISION", vec![k]),
        Projection::EnhancedUnified { alpha, beta } => ("EUCM", vec![alpha, beta]),
        Projection::Perspective => ("FULL_OPENCV", vec![k[0], k[1], p1, p2, k[2], d[0], d[1], d[2]]),
        Projection::Fisheye if lens.polynomial.radial_first => {
            ("RAD_TAN_THIN_PRISM_FISHEYE", [&k[..], &[p2, p1, s0, s1, s2, s3]].concat())
        }
        Projection::Fisheye if [p1, p2, s0, s2] == [0.0; 4] => ("OPENCV_FISHEYE", k[..4].to_vec()),
        Projection::Fisheye => ("THIN_PRISM_FISHEYE", vec![k[0], k[1], p1, p2, k[2], k[3], s0, s2]),
    };
    let read =
        Lens { projection: projection(name, &coefficients), polynomial: polynomial(name, &coefficients) };
    (read == *lens).then_some((name, coefficients))
}

/// COLMAP's number of a model.
pub(super) fn id(name: &str) -> i32 {
    MODELS.iter().position(|(model, _)| *model == name).expect("a name of this table") as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(model: &str, values: &[f64]) -> Result<([f64; 4], Option<Lens>), SceneError> {
        parameters(Path::new("cameras.txt"), 3, model, values)
    }

    #[test]
    fn every_model_takes_as_many_parameters_as_it_has() {
        for (model, count) in MODELS {
            let values: Vec<f64> = (0..count).map(|index| 100.0 / (index + 1) as f64).collect();
            let ([fx, fy, ..], lens) = read(model, &values).unwrap();
            if model == ROUND {
                assert_eq!((lens.map(|lens| lens.is_round()), fx), (Some(true), 100.0 / TAU));
                continue;
            }
            assert_eq!(fx == fy, model.starts_with("SIMPLE") || model.starts_with("RADIAL"), "{model}");
            assert_eq!(lens.is_none(), model.ends_with("PINHOLE"), "{model}");
            assert!(
                read(model, &values[1..])
                    .unwrap_err()
                    .to_string()
                    .contains(&format!("and {model} has {count}"))
            );
        }
    }

    #[test]
    fn the_lens_of_every_model_can_be_written() {
        for (model, count) in MODELS {
            let values: Vec<f64> = (0..count).map(|index| 0.5 / (index + 1) as f64).collect();
            let (pinhole, lens) = read(model, &values).unwrap();
            let (name, coefficients) = of_lens(lens.as_ref()).unwrap_or_else(|| panic!("{model}"));
            let of_camera = if name == ROUND { &values[..] } else { &pinhole[..] };
            let again = read(name, &[of_camera, &coefficients].concat()).unwrap();
            assert_eq!(again, (pinhole, lens), "{model} as {name}");
        }
        let polynomial = Polynomial { radial: [0.1, 0.1, 0.1, 0.1, 0.0, 0.0], ..Polynomial::default() };
        assert!(
            of_lens(Some(&Lens { projection: Projection::Perspective, polynomial })).is_none(),
            "COLMAP has no k4 there"
        );
    }

    /// COLMAP's formulas (`sensor/models.h`).
    #[test]
    fn coefficients_bend_what_colmap_bends_with_them() {
        let (point, [p1, p2], [sx, sy]) = ([0.3, 0.2], [0.01, -0.03], [0.02, -0.05]);
        let square = |[x, y]: [f64; 2]| x * x + y * y;
        let series = |r2: f64, k: [f64; 4]| 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3])));
        let bent = |[x, y]: [f64; 2], radial: f64| {
            let r2 = square([x, y]);
            [
                radial * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                radial * y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
            ]
        };
        let r2 = square(point);
        let angles = point.map(|coordinate| coordinate * r2.sqrt().atan() / r2.sqrt());
        let t2 = square(angles);
        let of_prism = bent(angles, series(t2, [0.1, -0.2, 0.3, -0.4]));
        let full = series(r2, [0.1, -0.2, 0.3, 0.0]) / series(r2, [-0.4, 0.5, -0.6, 0.0]);
        for (model, coefficients, [x, y]) in [
            ("OPENCV", &[0.1, -0.2, p1, p2][..], bent(point, series(r2, [0.1, -0.2, 0.0, 0.0]))),
            ("FULL_OPENCV", &[0.1, -0.2, p1, p2, 0.3, -0.4, 0.5, -0.6], bent(point, full)),
            (
                "THIN_PRISM_FISHEYE",
                &[0.1, -0.2, p1, p2, 0.3, -0.4, sx, sy],
                [of_prism[0] + sx * t2, of_prism[1] + sy * t2],
            ),
        ] {
            let lens = read(model, &[&[1.0, 1.0, 0.0, 0.0], coefficients].concat()).unwrap().1.unwrap();
            let shown = lens.distort(point);
            assert!((shown[0] - x).hypot(shown[1] - y) < 1e-12, "{model}: {shown:?}, and not {x}, {y}");
        }
    }

    #[test]
    fn coefficients_of_zero_are_a_pinhole_and_others_must_be_finite() {
        assert_eq!(
            read("OPENCV", &[5.0, 6.0, 3.0, 2.0, 0.0, 0.0, 0.0, 0.0]).unwrap(),
            ([5.0, 6.0, 3.0, 2.0], None)
        );
        let refused = read("SIMPLE_RADIAL", &[5.0, 3.0, 2.0, f64::NAN]).unwrap_err().to_string();
        assert!(refused.contains("camera 3 has distortion coefficients"), "{refused}");
    }
}

//! Where `convert` puts a splat.

use std::str::FromStr;

use clap::Args;
use genesplat::core::Similarity;
use glam::{DQuat, DVec3, EulerRot};

/// Largest length that is moved by, world units: no coordinate is believed beyond it.
const LENGTH_MAX: f64 = 1e9;
/// The same of a scale and its inverse.
const SCALE_MAX: f64 = 1e6;

/// A splat is stood upright, turned, scaled and moved, in this order.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct PlacementArgs {
    /// Turn the splat so that up becomes this axis: x, y, z, -x, -y or -z. Up is what the cameras of a RUN,
    /// or of --data, have as up on average, and -y for a file alone [default: as it is]
    #[arg(long, value_name = "AXIS", value_parser = axis, allow_hyphen_values = true)]
    pub(crate) up: Option<Axis>,
    /// Then turn it about x, about y and about z, in degrees, highlights with it [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = degrees, allow_hyphen_values = true)]
    rotate: Option<Vector>,
    /// Then make it so many times as large [default: 1]
    #[arg(long, value_name = "S", value_parser = scale)]
    scale: Option<f64>,
    /// Then move it, in the units that it has by then [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = length, allow_hyphen_values = true)]
    translate: Option<Vector>,
}

impl PlacementArgs {
    /// What it all comes to; `up` is that of the splat, of length 1.
    pub(crate) fn similarity(&self, up: DVec3) -> Similarity {
        let upright = self.up.map_or(DQuat::IDENTITY, |axis| DQuat::from_rotation_arc(up, axis.0));
        let [x, y, z] = self.rotate.map_or([0.0; 3], |Vector(degrees)| degrees.map(f64::to_radians));
        let turned =
            if [x, y, z] == [0.0; 3] { DQuat::IDENTITY } else { DQuat::from_euler(EulerRot::ZYX, z, y, x) };
        Similarity {
            rotation: turned * upright,
            scale: self.scale.unwrap_or(1.0),
            translation: self.translate.map_or(DVec3::ZERO, |Vector(by)| DVec3::from(by)),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axis(DVec3);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Vector([f64; 3]);

fn axis(text: &str) -> Result<Axis, String> {
    let (name, sign) = text.strip_prefix('-').map_or((text, 1.0), |name| (name, -1.0));
    let name = name.strip_prefix('+').unwrap_or(name);
    let direction = match name {
        "x" | "X" => DVec3::X,
        "y" | "Y" => DVec3::Y,
        "z" | "Z" => DVec3::Z,
        _ => return Err("x, y, z, -x, -y or -z is needed".into()),
    };
    Ok(Axis(sign * direction))
}

/// Three numbers with commas between them, none larger than this.
fn vector(text: &str, most: f64) -> Result<Vector, String> {
    let number = |word: &str| f64::from_str(word.trim()).ok().filter(|value| value.abs() <= most);
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    let three = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    three.map(Vector).ok_or_else(|| {
        format!("three numbers with commas between them are needed, none beyond {most:e} either way")
    })
}

fn degrees(text: &str) -> Result<Vector, String> {
    vector(text, 3600.0)
}

fn length(text: &str) -> Result<Vector, String> {
    vector(text, LENGTH_MAX)
}

fn scale(text: &str) -> Result<f64, String> {
    let range = 1.0 / SCALE_MAX..=SCALE_MAX;
    let scale = text.parse().ok().filter(|scale| range.contains(scale));
    scale.ok_or_else(|| "a number from 0.000001 to 1000000 is needed".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: DVec3, b: DVec3) -> bool {
        a.distance(b) < 1e-12
    }

    #[test]
    fn turns_are_about_x_then_y_then_z_in_degrees() {
        let args = PlacementArgs { rotate: Some(degrees("90, 0,90").unwrap()), ..PlacementArgs::default() };
        let turned = args.similarity(DVec3::NEG_Y);
        assert!(near(turned.point(DVec3::Y), DVec3::Z), "about x, and z stays");
        assert!(near(turned.point(DVec3::X), DVec3::Y));
        assert_eq!(PlacementArgs::default().similarity(DVec3::NEG_Y), Similarity::default());
    }

    #[test]
    fn up_becomes_the_axis_before_all_else() {
        for (word, direction) in
            [("z", DVec3::Z), ("-x", DVec3::NEG_X), ("y", DVec3::Y), ("-Y", DVec3::NEG_Y)]
        {
            let args = PlacementArgs { up: Some(axis(word).unwrap()), ..PlacementArgs::default() };
            assert!(near(args.similarity(DVec3::NEG_Y).point(DVec3::NEG_Y), direction), "{word}");
        }
        let args = PlacementArgs {
            up: Some(axis("z").unwrap()),
            rotate: Some(degrees("0,90,0").unwrap()),
            scale: Some(2.0),
            translate: Some(length("1,2,3").unwrap()),
        };
        let up = DVec3::new(0.6, 0.0, 0.8);
        assert!(near(args.similarity(up).point(up), DVec3::new(3.0, 2.0, 3.0)));
    }

    #[test]
    fn what_is_no_placement_is_refused() {
        assert!(["", "1,2", "1,2,3,4", "1,2,NaN", "1,2,1e10"].iter().all(|text| length(text).is_err()));
        assert!(["0", "-1", "inf", "x"].iter().all(|text| scale(text).is_err()));
        assert!(["", "w", "--x", "xy"].iter().all(|text| axis(text).is_err()));
    }
}

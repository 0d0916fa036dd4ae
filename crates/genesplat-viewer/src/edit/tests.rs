//! Boxes and brushes on clouds of a few Gaussians.

use std::f64::consts::FRAC_1_SQRT_2;

use super::*;

fn cloud(positions: &[[f32; 3]]) -> Gaussians {
    let mut cloud = Gaussians::zeros(positions.len());
    cloud.positions = positions.to_vec();
    cloud.opacity_logits = vec![2.0; positions.len()];
    cloud
}

/// From the origin along z, 100 px wide and high.
fn stroke(radius: f64, path: &[[f64; 2]]) -> Stroke {
    let pose = Pose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], fov_y: 1.0 };
    Stroke { pose, camera: None, width: 100, height: 100, radius, path: path.to_vec(), through: false }
}

fn erased(stroke: &Stroke, cloud: &Gaussians) -> Vec<u32> {
    stroke.rows(cloud, &stroke.pose.camera(stroke.width, stroke.height))
}

#[test]
fn a_box_removes_what_is_in_it_or_all_else_however_it_is_turned() {
    let cloud = cloud(&[[0.0; 3], [1.9, 0.0, 0.0], [0.0, 1.9, 0.0], [5.0, 5.0, 5.0]]);
    // Half a side of 2 along its x, which points along the world's y after a quarter turn about z.
    let upright = Crop {
        centre: [0.0; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        half_sizes: [2.0, 0.5, 0.5],
        removes: Side::Inside,
    };
    let turned = Crop { rotation: [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2], ..upright };
    assert_eq!(upright.rows(&cloud), [0, 1]);
    assert_eq!(turned.rows(&cloud), [0, 2]);
    assert_eq!(Crop { removes: Side::Outside, ..turned }.rows(&cloud), [1, 3]);
    assert_eq!(Crop { centre: [5.0; 3], ..upright }.rows(&cloud), [3]);
}

#[test]
fn a_brush_takes_the_front_layer_and_all_layers_where_it_goes_through() {
    // A floater before a wall, a wall beside it, and what is behind the camera.
    let mut cloud =
        cloud(&[[0.0, 0.0, 2.0], [0.0, 0.0, 4.0], [0.0, 0.0, 4.2], [0.9, 0.0, 4.0], [0.0, 0.0, -2.0]]);
    let dab = stroke(6.0, &[[50.0, 50.0]]);
    assert_eq!(erased(&dab, &cloud), [0]);
    assert_eq!(erased(&Stroke { through: true, ..dab.clone() }, &cloud), [0, 1, 2]);
    let without_floater = cloud.gather(&[1, 2, 3, 4]);
    assert_eq!(erased(&dab, &without_floater), [0, 1], "a wall has some thickness");
    // What nobody sees is no layer, and goes with what is behind it.
    cloud.opacity_logits[0] = -6.0;
    assert_eq!(erased(&dab, &cloud), [0, 1, 2]);
}

#[test]
fn a_stroke_reaches_from_point_to_point_and_has_a_front_at_each_place() {
    // To the left a floater before the wall; to the right the wall alone.
    let cloud = cloud(&[[-0.8, 0.0, 2.0], [-1.6, 0.0, 4.0], [1.6, 0.0, 4.0], [0.0, 1.0, 4.0]]);
    let line = stroke(5.0, &[[10.0, 50.0], [90.0, 50.0]]);
    assert_eq!(erased(&line, &cloud), [0, 2], "and not what is below the line");
    assert_eq!(erased(&stroke(5.0, &[[10.0, 90.0], [90.0, 90.0]]), &cloud), [0_u32; 0]);
}

#[test]
fn edits_are_undone_in_turn_to_the_same_rows() {
    let rows: Vec<[f32; 3]> = (0..6).map(|row| [row as f32, 0.0, 0.0]).collect();
    let mut edits = Edits::of(cloud(&rows));
    let xs = |edits: &Edits| edits.cloud().positions.iter().map(|p| p[0] as u32).collect::<Vec<_>>();
    edits.remove(&[1, 4]);
    assert_eq!(xs(&edits), [0, 2, 3, 5]);
    edits.remove(&[0, 3]);
    assert_eq!((xs(&edits), edits.count(), edits.gone()), (vec![2, 3], 2, 4));
    assert_eq!((edits.undo(), xs(&edits)), (Some(vec![0, 5]), vec![0, 2, 3, 5]));
    assert_eq!((edits.undo(), xs(&edits)), (Some(vec![1, 4]), vec![0, 1, 2, 3, 4, 5]));
    assert_eq!((edits.undo(), edits.count(), edits.gone()), (None, 0, 0));
}

//! Every stage's buffers against those of the CPU.

use fearless_simd::Level;
use genesplat_core::{RowEdit, StatisticsRequest};
use genesplat_kernels::cpu::{Pinhole, Target, ViewBuffers};

use super::*;
use crate::device::memory::Memory;
use crate::layout::{INTERSECTION_GRADIENT_FLOATS, SPLAT_FLOATS, TILE, ViewPass};

const GRADIENT: usize = INTERSECTION_GRADIENT_FLOATS as usize;

/// A step that moves nothing.
fn looking(settings: &RenderSettings) -> TrainStep {
    TrainStep { update: None, ..step(1, *settings) }
}

/// The buffers of a view on the CPU, forward and backward, and its loss.
fn cpu_buffers(cloud: &Gaussians, settings: &RenderSettings) -> (ViewBuffers, f32) {
    let (level, camera) = (Level::new(), Pinhole::from(&camera()));
    let mut buffers = ViewBuffers::default();
    buffers.render(level, cloud, &camera, settings);
    let step = TrainStep { statistics: StatisticsRequest::default(), ..looking(settings) };
    let loss = buffers.backward(level, &camera, &Target::from(&view()), &step).unwrap();
    (buffers, loss)
}

/// Reads `count` values of a buffer.
fn read<T: bytemuck::Pod>(gpu: &GpuBackend, memory: &Memory, count: usize) -> Vec<T> {
    gpu.engine.read_values(memory, count as u64).unwrap()
}

/// Numbers of the intersections of each tile, nearest first, and the splat of each.
fn tile_lists(gpu: &GpuBackend, settings: &RenderSettings, rows: usize) -> (Vec<Vec<u32>>, Vec<u32>) {
    let view = ViewPass::new(&camera(), settings, rows as u64);
    let capacity = gpu.lists.capacity as usize;
    let numbers: Vec<u32> = read(gpu, &gpu.lists.intersections, capacity);
    let ranges: Vec<[u32; 2]> = read(gpu, &gpu.lists.ranges, view.tiles() as usize);
    let lists = ranges.iter().map(|&[begin, end]| numbers[begin as usize..end as usize].to_vec()).collect();
    (lists, read(gpu, &gpu.lists.intersection_splats, capacity))
}

#[test]
fn every_stage_matches() {
    let Some(mut gpu) = gpu() else { return };
    for filter in filters() {
        for degree in 0..=3 {
            stages_match(&mut gpu, filtered_cloud(400, filter), &settings(degree, filter))
                .unwrap_or_else(|error| panic!("{filter:?}, degree {degree}: {error}"));
        }
    }
}

/// Lists of several batches, whose ends lie behind finished pixels. The rows of the first cloud are all
/// written, so that those which the others have to clear are not zero.
#[test]
fn every_stage_matches_where_pixels_are_finished() {
    let Some(mut gpu) = gpu() else { return };
    for logit in CROWD_LOGITS {
        stages_match(&mut gpu, crowd(logit), &settings(2, ScreenFilter::Classic))
            .unwrap_or_else(|error| panic!("logit {logit}: {error}"));
    }
}

fn stages_match(gpu: &mut GpuBackend, cloud: Gaussians, settings: &RenderSettings) -> Result<(), String> {
    let (buffers, loss) = cpu_buffers(&cloud, settings);
    gpu.upload(cloud.into()).unwrap();
    gpu.train_step(&looking(settings)).unwrap();
    let report = gpu.report().unwrap();
    splats_match(gpu, &buffers)?;
    lists_match(gpu, &buffers, settings)?;
    assert_eq!(
        (report.visible, report.intersections),
        (buffers.splats.len(), buffers.bins.intersections.len())
    );
    let values = buffers.image.planes.len();
    compare("rasterise", "image", read(gpu, &gpu.pixels.image, values), buffers.image.planes.clone())?;
    compare("loss", "value", [report.loss], [loss])?;
    let gradient = read(gpu, &gpu.pixels.gradient, values);
    compare("loss gradient", "dL/dimage", gradient, buffers.image_gradient.clone())
}

fn splats_match(gpu: &GpuBackend, buffers: &ViewBuffers) -> Result<(), String> {
    let splats: Vec<[f32; SPLAT_FLOATS as usize]> = read(gpu, &gpu.lists.splats, gpu.gaussian_count());
    let (mut actual, mut expected) = (Vec::new(), Vec::new());
    for (_, splat) in buffers.splats.iter() {
        let s = &splats[splat.row as usize];
        actual.push([s[0], s[1], s[2], s[3], s[7], s[4], s[5], s[6], s[8], s[9], s[10]]);
        let ([u, v], [a, b, c]) = (splat.mean_px, splat.conic_log2);
        let ([width, height], [red, green, blue]) = (splat.half_extent_px, splat.rgb);
        expected.push([u, v, splat.log2_opacity, width, height, a, b, c, red, green, blue]);
    }
    // Column by column: some are thousands, some are parts of one.
    (0..11).try_for_each(|k| {
        let (actual, expected) = (actual.iter().map(|s| s[k]), expected.iter().map(|s| s[k]));
        compare("project", &format!("splats, float {k}"), actual, expected)
    })
}

/// The same splats in every tile in the same order, and the same sums of each of them.
fn lists_match(gpu: &GpuBackend, buffers: &ViewBuffers, settings: &RenderSettings) -> Result<(), String> {
    let (lists, splats_of) = tile_lists(gpu, settings, gpu.gaussian_count());
    let rows: Vec<[f32; GRADIENT]> =
        read(gpu, &gpu.pixels.intersection_gradients, gpu.lists.capacity as usize);
    let (mut actual, mut expected) = (Vec::new(), Vec::new());
    for (tile, numbers) in lists.iter().enumerate() {
        let ours: Vec<u32> = numbers.iter().map(|&number| splats_of[number as usize]).collect();
        let theirs: Vec<u32> = buffers
            .bins
            .tile(tile)
            .iter()
            .map(|intersection| buffers.splats.get(intersection.splat).row)
            .collect();
        if ours != theirs {
            return Err(format!("bin: tile {tile} lists {ours:?}, not {theirs:?}"));
        }
        actual.extend(numbers.iter().map(|&number| rows[number as usize]));
        let first = buffers.bins.tile_starts[tile] as usize;
        expected.extend(buffers.gradient_rows[first..][..numbers.len()].iter().map(|row| row.0));
    }
    // The CPU's rows have the moments, the absolute sums, the colours and the pixels in this order.
    let place = |column: usize| if column < 6 { column } else { column + 2 };
    (0..9).try_for_each(|k| {
        let actual = actual.iter().map(|row: &[f32; GRADIENT]| row[k]);
        let expected = expected.iter().map(|row: &[f32; 16]| row[place(k)]);
        compare("rasterise_backward", &format!("column {k}"), actual, expected)
    })
}

#[test]
fn gradients_and_statistics_match() {
    check_gradients_and_statistics(view());
}

#[test]
fn masked_gradients_and_statistics_match() {
    check_gradients_and_statistics(masked_view(90));
}

fn check_gradients_and_statistics(view: View) {
    let (Some(mut gpu), mut cpu) = (gpu(), cpu()) else { return };
    gpu.set_views(std::slice::from_ref(&view)).unwrap();
    cpu.set_views(&[view]).unwrap();
    let signals = [
        DensitySignal::Signed,
        DensitySignal::Absolute,
        DensitySignal::PixelWeighted { depth_threshold: 2.0 },
    ];
    for filter in filters() {
        for signal in signals {
            let mut step = step(1, settings(3, filter));
            step.statistics.density = Some(signal);
            let twins: [&mut dyn Device; 2] = [&mut gpu, &mut cpu];
            let [actual, expected] = twins.map(|twin| {
                twin.upload(filtered_cloud(400, filter).into()).unwrap();
                twin.train_step(&step).unwrap();
                // After one step, the first moments are a tenth of the gradients.
                (twin.state().unwrap().moments, twin.statistics().unwrap())
            });
            let context = |error: String| panic!("{filter:?}, {signal:?}: {error}");
            compare_clouds("project_backward", &actual.0.first, &expected.0.first).unwrap_or_else(context);
            compare_gradient_rows(&actual.0.first, &expected.0.first).unwrap_or_else(context);
            let mut planted = actual.0.first;
            let lost = shortest_row(&wide(&expected.0.first.positions));
            planted.positions[lost] = [0.0; 3];
            compare_clouds("project_backward", &planted, &expected.0.first)
                .expect("a norm does not show a row that is lost");
            assert!(
                compare_gradient_rows(&planted, &expected.0.first).is_err(),
                "a row that is lost is missed"
            );
            let (actual, expected) = (actual.1, expected.1);
            assert_eq!(actual.weight_sum, expected.weight_sum, "what is counted is equal");
            assert_eq!(actual.gene_views, expected.gene_views);
            compare("statistics", "gradient", actual.gradient_sum, expected.gradient_sum)
                .unwrap_or_else(context);
            let genes = |sums: Vec<[f32; 7]>| sums.as_flattened().to_vec();
            let (actual, expected) = (genes(actual.gene_gradient_sum), genes(expected.gene_gradient_sum));
            compare("statistics", "genes", actual, expected).unwrap_or_else(context);
        }
    }
}

/// Tiles lie on the border of the picture, and pictures may be smaller than a tile or than SSIM's window.
#[test]
fn any_size_of_picture_is_rendered() {
    let Some(mut gpu) = gpu() else { return };
    let mut cpu = cpu();
    let settings = settings(1, ScreenFilter::Classic);
    gpu.upload(cloud(60).into()).unwrap();
    cpu.upload(cloud(60).into()).unwrap();
    for (width, height) in [(1, 1), (5, 3), (TILE, TILE), (17, 40)] {
        let camera = camera().resized(width, height);
        let image = gpu.render(&camera, &settings).unwrap();
        let expected = cpu.render(&camera, &settings).unwrap();
        compare("rasterise", &format!("{width}x{height}"), image.planes, expected.planes).unwrap();
    }
    gpu.upload(Gaussians::default().into()).unwrap();
    assert_eq!(gpu.render(&camera(), &settings).unwrap().pixel(3, 4), settings.background, "an empty cloud");
}

#[test]
fn poison_never_reaches_a_pixel() {
    let Some(mut gpu) = gpu() else { return };
    let cloud = poisoned_cloud();
    for filter in filters() {
        gpu.upload(cloud.clone().into()).unwrap();
        let image = gpu.render(&camera(), &settings(3, filter)).unwrap();
        assert!(image.planes.iter().all(|v| v.is_finite()), "{filter:?}");
    }
}

/// Where a Gaussian exceeds its opacity, by rounding, it counts as its opacity.
#[test]
fn far_needles_leave_everything_finite() {
    let Some(mut gpu) = gpu() else { return };
    for filter in filters() {
        gpu.upload(far_needles().into()).unwrap();
        let image = gpu.render(&camera(), &settings(0, filter)).unwrap();
        assert!(image.planes.iter().all(|v| (0.0..10.0).contains(v)), "{filter:?}: the picture");
        gpu.train_step(&step(1, settings(0, filter))).unwrap();
        let report = gpu.report().unwrap();
        assert!(report.intersections > 100 && report.loss.is_finite(), "{filter:?}: {report:?}");
        let stepped = gpu.download().unwrap();
        let genes = (0..stepped.len()).flat_map(|row| stepped.genes(row));
        assert!(genes.into_iter().all(f32::is_finite), "{filter:?}: parameters");
        assert!(stepped.rotations.as_flattened().iter().all(|v| v.is_finite()), "{filter:?}: rotations");
    }
}

/// A cloud whose first rows, in the middle of the picture, have one parameter each that is not a number; and
/// how many these are.
fn cloud_with_nans(filter: ScreenFilter) -> (Gaussians, u32) {
    let mut cloud = filtered_cloud(60, filter);
    let rows = if cloud.filter_3d.is_some() { 15 } else { 14 };
    for row in 0..rows {
        cloud.positions[row] = [0.0, 0.0, 2.0];
        cloud.opacity_logits[row] = 4.0;
        match row {
            0..3 => cloud.positions[row][row] = f32::NAN,
            3..6 => cloud.log_scales[row][row - 3] = f32::NAN,
            6..10 => cloud.rotations[row][row - 6] = f32::NAN,
            10 => cloud.opacity_logits[row] = f32::NAN,
            11..14 => cloud.sh[row][[0, 5, 47][row - 11]] = f32::NAN,
            _ => cloud.filter_3d.iter_mut().for_each(|filter| filter[row] = f32::NAN),
        }
    }
    (cloud, rows as u32)
}

/// On every driver, whatever its minima and maxima make of what is not a number.
#[test]
fn a_gaussian_with_a_nan_is_none() {
    let Some(mut gpu) = gpu() else { return };
    for filter in filters() {
        let (cloud, rows) = cloud_with_nans(filter);
        let mut step = step(1, settings(3, filter));
        step.update = None;
        gpu.upload(cloud.into()).unwrap();
        let image = gpu.render(&camera(), &step.settings).unwrap();
        gpu.train_step(&step).unwrap();
        assert_eq!(gpu.statistics().unwrap().weight_sum[..11], [0.0; 11], "{filter:?}: its place is unknown");
        gpu.edit(Edit::Rows(&RowEdit::keep((rows..60).collect()))).unwrap();
        let without = gpu.render(&camera(), &step.settings).unwrap();
        assert!(image == without, "{filter:?}");
    }
}

//! What is known of a scene before it is trained.

use anyhow::Result;
use genesplat::core::View;
use genesplat::io::{Scene, ScenePhoto, list_scene, plural};
use genesplat::run::numbers::{memory, thousands, time_left};
use genesplat::run::scene;
use genesplat::run::settings::Dataset;
use genesplat::train::scene::initialise::scene_extent;
use genesplat::train::{Schedule, TrainConfig};

use super::cameras::{PointsSeen, points_seen};
use super::cost::Needs;
use super::{Fact, Report, cameras, offset, photos};

/// Iterations of a quick run, whose time is said beside that of the run that no flag changes.
const QUICK: u32 = 7000;

pub(crate) fn inspect_scene(dataset: &Dataset, config: &TrainConfig) -> Result<Report> {
    let settings = config.clone().resolve()?;
    let with_depth = dataset.depth.serves(config.method.name);
    let scene = scene::load_to_inspect(dataset, with_depth, settings.config().seed)?;
    let has_depth = scene.train.iter().any(|view| view.depth.is_some());
    let settings = if has_depth { settings.with_depth() } else { settings };
    let views: Vec<&View> = scene.train.iter().chain(&scene.test).collect();
    let seen = points_seen(&views, &scene.points);
    let list = list_scene(&dataset.path, &dataset.options())?;
    let mut facts = found(&scene, &views, &seen)?;
    facts.extend(lenses(&list.photos));
    facts.extend(scene.digests.offset.map(offset));
    let no_extent =
        scene_extent(scene.train.iter().map(|view| &view.camera)).err().map(|error| error.to_string());
    let notices = scene.notices.clone();
    let doubts = scene::doubts(&scene).iter().map(ToString::to_string).collect();
    let warnings = [
        Vec::from_iter(no_extent),
        doubts,
        notices,
        cameras::warnings(&views, &seen),
        photos::warnings(&views)?,
    ]
    .concat();
    facts.extend(expected(&scene, &settings)?);
    facts.push(timeline(&settings, scene.train.len()));
    Ok(Report { kind: "scene", facts, warnings })
}

fn found(scene: &Scene, views: &[&View], points_seen: &PointsSeen) -> Result<Vec<Fact>> {
    let extent = scene_extent(scene.train.iter().map(|view| &view.camera)).ok();
    let mut counts = points_seen.counts.clone();
    counts.sort_unstable();
    let mut facts = vec![
        Fact::new("photos", views.len(), thousands(views.len())),
        Fact::new(
            "test photos",
            scene.test.len(),
            format!("{} of them, which training never sees", scene.test.len()),
        ),
        sizes(views),
        field_of_view(views),
        Fact::new("points", scene.points.len(), thousands(scene.points.len())),
        Fact::new(
            "points in a photo",
            counts[counts.len() / 2],
            format!("{} to {}", thousands(counts[0]), thousands(counts[counts.len() - 1])),
        ),
    ];
    facts.extend(extent.map(|extent| {
        let shown = format!("{extent:.3} world units: 1.1 times the farthest camera from their middle");
        Fact::new("extent", extent, shown)
    }));
    let masked = views.iter().filter(|view| view.mask.is_some()).count();
    if masked > 0 {
        facts.push(Fact::new(
            "masked photos",
            masked,
            format!("{masked}: what their masks hide counts for nothing"),
        ));
    }
    if let Some(depth) = points_seen.depth {
        facts.push(Fact::new(
            "depth",
            depth,
            format!("{depth:.3} world units: half of what the photos show is nearer"),
        ));
    }
    Ok(facts)
}

fn sizes(views: &[&View]) -> Fact {
    let mut sizes: Vec<[u32; 2]> =
        views.iter().map(|view| [view.photo.width(), view.photo.height()]).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let [width, height] = sizes[0];
    let more = if sizes.len() > 1 { format!(", and {} other sizes", sizes.len() - 1) } else { String::new() };
    Fact::new("size", vec![width, height], format!("{width}x{height} pixels as they are trained on{more}"))
}

fn field_of_view(views: &[&View]) -> Fact {
    let degrees = |view: &&View| 2.0 * view.camera.tan_half_fov()[0].atan().to_degrees();
    let angles: Vec<f64> = views.iter().map(degrees).collect();
    let (least, most) =
        angles.iter().fold((f64::INFINITY, 0.0f64), |(a, b), &angle| (a.min(angle), b.max(angle)));
    let shown = if most - least < 0.5 {
        format!("{least:.0} degrees")
    } else {
        format!("{least:.0} to {most:.0} degrees")
    };
    Fact::new("field of view", least, format!("{shown} across"))
}

/// How many cameras there are, and what their lenses do.
fn lenses(photos: &[ScenePhoto]) -> [Fact; 2] {
    let mut cameras = Vec::new();
    for ScenePhoto { camera, lens, .. } in photos {
        let camera = (camera.width, camera.height, camera.focal_px, camera.principal_px, *lens);
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
    }
    let cut = photos.iter().filter(|photo| photo.is_cut()).count();
    let bend_px = photos.iter().try_fold(0.0f64, |most, photo| photo.bend_px().map(|bend| most.max(bend)));
    let shown = match bend_px {
        Some(0.0) => "pinhole: the photos are straight".into(),
        Some(bend) => {
            format!("moves the corners of a photo by up to {bend:.0} of its pixels, which is undone")
        }
        None if cut > 0 => {
            format!("so wide that {cut} {} cut into views", plural(cut, "photo is", "photos are"))
        }
        None => "so wide that straight photos show less than it did".into(),
    };
    let different = plural(cameras.len(), "for all photos", "that differ in size, focal length or lens");
    [
        Fact::new("cameras", cameras.len(), format!("{} {different}", thousands(cameras.len()))),
        Fact::new("lens", bend_px.map_or(serde_json::Value::Null, Into::into), shown),
    ]
}

/// What happens when, a line for each event.
fn timeline(settings: &Schedule, photos: usize) -> Fact {
    let lines = settings.lines(photos);
    let name = settings.config().method.name;
    let shown = lines.iter().map(|line| format!("\n  {line}")).collect::<String>();
    Fact::new(
        "timeline",
        lines,
        format!("of --method {name}, {} steps:{shown}", thousands(settings.iterations as usize)),
    )
}

fn expected(scene: &Scene, settings: &Schedule) -> Result<[Fact; 3]> {
    let needs = Needs::of(scene, settings)?;
    let quick = TrainConfig { iterations: QUICK, ..settings.config().clone() }.resolve()?;
    let [all, quick] = [settings, &quick].map(|settings| needs.seconds(scene, settings));
    let shown = format!(
        "at most about {} on this machine's CPU for {} iterations; {} with --iterations {QUICK}",
        time_left(all),
        thousands(settings.iterations as usize),
        time_left(quick)
    );
    Ok([
        Fact::new("Gaussians", needs.gaussians, format!("at most {}", thousands(needs.gaussians))),
        Fact::new("memory", needs.memory_bytes, format!("at most about {}", memory(needs.memory_bytes))),
        Fact::new("time", all, shown),
    ])
}

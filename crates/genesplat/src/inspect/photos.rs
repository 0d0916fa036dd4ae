//! Photos that harm a reconstruction: blurred, overexposed, or there twice.

use genesplat::core::{Photo, PhotoLost, View, median};
use genesplat::train::scene::surroundings::are_on_white;
use rayon::prelude::*;

use super::listed;
use crate::sharpness::laplacian_variance;

/// A photo is blurred where its edges have less than this fraction of the usual energy.
const BLURRED: f64 = 0.15;
/// A photo is overexposed where more than this fraction of its pixels is white, and the usual photo has less
/// than half.
const OVEREXPOSED: f64 = 0.25;
/// A pixel is white from this value on, in all channels.
const WHITE: u8 = 254;
/// Photos are compared by the mean colours of so many parts across and down.
const CELLS: usize = 16;
/// Two photos are one, saved twice, where their parts differ by less than this, root mean square, in 8-bit
/// values. JPEG's qualities from 95 to 25 move them by 0.1 to 1.4, another size by 1.5; neighbours of fox,
/// fern and plush are 6 apart.
const ALIKE: f64 = 2.0;
/// Fewer photos have no usual one.
const PHOTOS_MIN: usize = 5;

/// What is measured of one photo.
struct Measures {
    /// Variance of the Laplacian of its brightness, 8-bit values squared.
    sharpness: f64,
    /// Fraction of its pixels.
    white: f64,
}

/// One sentence for each kind of trouble.
pub(super) fn warnings(views: &[&View]) -> Result<Vec<String>, PhotoLost> {
    let measure = |view: &&View| Ok(measure(&*view.photo.read()?));
    let measures: Vec<Measures> = views.par_iter().map(measure).collect::<Result<_, PhotoLost>>()?;
    let (on_white, twins) = (on_white(views)?, duplicates(views)?);
    if views.len() < PHOTOS_MIN {
        return Ok([on_white, twins].into_iter().flatten().collect());
    }
    Ok([blurred(views, &measures), overexposed(views, &measures), on_white, twins]
        .into_iter()
        .flatten()
        .collect())
}

fn blurred(views: &[&View], measures: &[Measures]) -> Option<String> {
    let usual = median(measures.iter().map(|photo| photo.sharpness))?;
    let names = those(views, measures, |photo| photo.sharpness < BLURRED * usual);
    (!names.is_empty()).then(|| {
        format!(
            "{} of {} photos have far softer edges than the others ({}): leave out what is blurred",
            names.len(),
            views.len(),
            listed(&names)
        )
    })
}

fn overexposed(views: &[&View], measures: &[Measures]) -> Option<String> {
    let usual = median(measures.iter().map(|photo| photo.white))?;
    let names = those(views, measures, |photo| photo.white > OVEREXPOSED && photo.white > 2.0 * usual);
    (!names.is_empty()).then(|| {
        format!(
            "{} of {} photos are mostly white ({}): what is overexposed has no colour to learn from",
            names.len(),
            views.len(),
            listed(&names)
        )
    })
}

/// Training says so, too.
fn on_white(views: &[&View]) -> Result<Option<String>, PhotoLost> {
    let sentence = "the photos show their subject on white: train with --background white, which leaves that to the background";
    Ok(are_on_white(views)?.then(|| sentence.into()))
}

/// Photos that show the same, saved twice or anew.
fn duplicates(views: &[&View]) -> Result<Option<String>, PhotoLost> {
    let cells = |view: &&View| Ok(cells(&*view.photo.read()?));
    let small: Vec<Vec<f64>> = views.par_iter().map(cells).collect::<Result<_, PhotoLost>>()?;
    let is_like = |a: &[f64], b: &[f64]| {
        let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
        squares < ALIKE * ALIKE * a.len() as f64
    };
    let twin = |at: usize| (0..at).find(|&before| is_like(&small[before], &small[at]));
    let pairs: Vec<String> = (0..views.len())
        .filter_map(|at| Some(format!("{} and {}", views[twin(at)?].name, views[at].name)))
        .collect();
    let shown: Vec<&str> = pairs.iter().map(String::as_str).collect();
    let sentence =
        || format!("photos are there twice ({}): one of each pair counts double; remove it", listed(&shown));
    Ok((!shown.is_empty()).then(sentence))
}

/// Mean colours of a photo's parts.
fn cells(photo: &Photo) -> Vec<f64> {
    let (width, height) = (photo.width as usize, photo.height as usize);
    let mut sums = vec![[0.0; 4]; CELLS * CELLS];
    for (index, rgb) in photo.rgb.chunks_exact(3).enumerate() {
        let [row, column] = [index / width * CELLS / height, index % width * CELLS / width];
        let cell = &mut sums[CELLS * row + column];
        (0..3).for_each(|channel| cell[channel] += f64::from(rgb[channel]));
        cell[3] += 1.0;
    }
    sums.iter().flat_map(|[r, g, b, count]| [r, g, b].map(|sum| sum / count.max(1.0))).collect()
}

fn those<'a>(views: &[&'a View], measures: &[Measures], is_bad: impl Fn(&Measures) -> bool) -> Vec<&'a str> {
    views
        .iter()
        .zip(measures)
        .filter(|(_, photo)| is_bad(photo))
        .map(|(view, _)| view.name.as_str())
        .collect()
}

fn measure(photo: &Photo) -> Measures {
    let white = photo.rgb.chunks_exact(3).filter(|pixel| pixel.iter().all(|&value| value >= WHITE)).count();
    Measures { sharpness: laplacian_variance(photo), white: white as f64 / (photo.rgb.len() / 3) as f64 }
}

#[cfg(test)]
mod tests {

    use super::super::cameras::tests::camera_at;
    use super::*;

    fn view(name: &str, photo: Photo) -> View {
        View { name: name.into(), camera: camera_at([0.0; 3]), photo: photo.into(), mask: None, depth: None }
    }

    fn noise(seed: u32, contrast: u32) -> Photo {
        let value = |at: u32| (100 + (at * 7919 + seed * 104_729) % 251 % contrast) as u8;
        Photo { width: 20, height: 20, rgb: (0..1200).map(value).collect() }
    }

    #[test]
    fn the_odd_ones_out_are_named() {
        let mut views: Vec<View> =
            (0..6).map(|seed| view(&format!("{seed}.jpg"), noise(seed, 100))).collect();
        let found = |views: &[View]| warnings(&views.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(found(&views), [] as [String; 0]);
        views[1].photo = noise(1, 3).into();
        views[3].photo = Photo { rgb: vec![255; 1200], ..noise(3, 100) }.into();
        views[5].photo = views[0].photo.clone();
        let found = found(&views);
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(found[0].contains("softer edges") && found[0].contains("(1.jpg, 3.jpg)"), "{found:?}");
        assert!(
            found[1].contains("mostly white (3.jpg)") && found[2].contains("0.jpg and 5.jpg"),
            "{found:?}"
        );
        views.iter_mut().for_each(|view| view.photo = Photo { rgb: vec![255; 1200], ..noise(0, 100) }.into());
        let found = warnings(&views[..2].iter().collect::<Vec<_>>()).unwrap();
        assert!(found[0].contains("--background white") && found.len() == 2, "{found:?}");
    }

    #[test]
    fn a_photo_that_was_saved_anew_is_still_the_same() {
        let photo = |rgb: Vec<u8>| Photo { width: 80, height: 60, rgb };
        let plain: Vec<u8> = (0..14_400).map(|at| (at / 80 % 256) as u8).collect();
        let brighter = |rows: std::ops::Range<usize>, by: u8| {
            let mut rgb = plain.clone();
            rgb[240 * rows.start..240 * rows.end]
                .iter_mut()
                .for_each(|value| *value = value.saturating_add(by));
            photo(rgb)
        };
        let twice =
            |other| duplicates(&[&view("a.jpg", photo(plain.clone())), &view("b.jpg", other)]).unwrap();
        assert!(twice(brighter(0..60, 1)).unwrap().contains("a.jpg and b.jpg"));
        // A coarse JPEG is off by more than that here and there.
        assert!(twice(brighter(0..4, 4)).is_some());
        assert_eq!(twice(brighter(0..60, 4)), None);
        // The next photo of a walk shows the same, a little aside.
        assert_eq!(twice(photo(plain[2400..].iter().chain(&plain[..2400]).copied().collect())), None);
    }
}

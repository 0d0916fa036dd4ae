//! Curves as SVG.
//!
//! A chart is as wide as a narrow screen, so that its labels are as large as the page's text there.

use maud::{Markup, Render, html};

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 200.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 22.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 34.0;
/// Points of a curve: more than so narrow a drawing can show.
const POINTS: usize = 200;
const TICKS: f64 = 4.0;
/// Told apart by most eyes (Okabe and Ito); `style.css` has them for light and dark ground.
const COLOURS: [&str; 4] = ["var(--c0)", "var(--c1)", "var(--c2)", "var(--c3)"];
/// Strokes and gaps: where there are more curves than colours, the next four are dashed, and so on.
const DASHES: [&str; 4] = ["none", "7 3", "2 2", "9 2 2 2"];

/// Curves over one axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chart {
    /// What is above it.
    pub caption: String,
    /// What lies along the axis.
    pub x_name: &'static str,
    /// The lines.
    pub series: Vec<Series>,
}

/// A curve, from left to right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// For the legend.
    pub name: String,
    /// Where it goes along.
    pub points: Vec<[f64; 2]>,
}

/// An axis: values `low..high` on `from..to` units of the drawing.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    /// Around all of `values`; never empty.
    fn around(values: impl Iterator<Item = f64>, from: f64, to: f64) -> Self {
        let (mut low, mut high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if !(low.is_finite() && high.is_finite()) {
            (low, high) = (0.0, 1.0);
        }
        if high - low <= 1e-12 * high.abs().max(1e-12) {
            let room = if high == 0.0 { 1.0 } else { 0.5 * high.abs() };
            (low, high) = (low - room, high + room);
        }
        Self { low, high, from, to }
    }

    fn at(&self, value: f64) -> f64 {
        self.from + (value - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    /// Round values within the axis: steps of 1, 2 or 5 times a power of ten.
    fn ticks(&self) -> Vec<f64> {
        let rough = (self.high - self.low) / TICKS;
        let power = 10f64.powf(rough.log10().floor());
        let distance = |step: &f64| (step / rough).ln().abs();
        let steps = [1.0, 2.0, 5.0, 10.0].map(|nice| nice * power).into_iter();
        let step = steps.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(power);
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

/// A figure; nothing where no curve has two points.
impl Render for Chart {
    fn render(&self) -> Markup {
        let curves: Vec<_> = self.series.iter().map(|series| thinned(&series.points, POINTS)).collect();
        let along = |axis: usize| curves.iter().flatten().map(move |point| point[axis]);
        let (x, y) =
            (Axis::around(along(0), LEFT, WIDTH - RIGHT), Axis::around(along(1), HEIGHT - BOTTOM, TOP));
        let place = |point: &[f64; 2]| format!("{:.1} {:.1}", x.at(point[0]), y.at(point[1]));
        let line = |points: &[[f64; 2]]| points.iter().map(place).collect::<Vec<_>>().join("L");
        html! {
            @if self.series.iter().any(|series| series.points.len() > 1) {
                figure {
                    figcaption { (self.caption) }
                    svg viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" {
                        title { (self.caption) }
                        (axes(&x, &y, self.x_name))
                        @for (index, points) in curves.iter().enumerate() {
                            path.line style=(stroke(index)) d={ "M" (line(points)) } {}
                        }
                    }
                    @if self.series.len() > 1 { (legend(&self.series)) }
                }
            }
        }
    }
}

fn axes(x: &Axis, y: &Axis, x_name: &str) -> Markup {
    let bottom = HEIGHT - BOTTOM;
    html! {
        @for (at, value) in y.ticks().into_iter().map(|value| (y.at(value), value)) {
            path.grid d={ "M" (LEFT) " " (tenths(at)) "H" (WIDTH - RIGHT) } {}
            text x=(LEFT - 5.0) y=(tenths(at + 4.0)) text-anchor="end" { (label(value)) }
        }
        @for (at, value) in x.ticks().into_iter().map(|value| (tenths(x.at(value)), value)) {
            path.grid d={ "M" (at) " " (bottom) "v4" } {}
            text x=(at) y=(bottom + 15.0) text-anchor="middle" { (label(value)) }
        }
        text x=(f64::midpoint(LEFT, WIDTH - RIGHT)) y=(HEIGHT - 4.0) text-anchor="middle" { (x_name) }
    }
}

fn legend(series: &[Series]) -> Markup {
    html! {
        ul.legend {
            @for (index, series) in series.iter().enumerate() {
                li {
                    svg viewBox="0 0 24 8" aria-hidden="true" {
                        path.line style=(stroke(index)) d="M0 4H24" {}
                    }
                    span { (series.name) }
                }
            }
        }
    }
}

/// A place in a drawing, to a tenth of a unit.
pub(super) fn tenths(place: f64) -> String {
    format!("{place:.1}")
}

/// What tells the curve of this index from the others.
fn stroke(index: usize) -> String {
    let (colour, dash) = (COLOURS[index % COLOURS.len()], DASHES[index / COLOURS.len() % DASHES.len()]);
    format!("stroke:{colour};stroke-dasharray:{dash}")
}

/// At most `count` points: means of neighbours.
fn thinned(points: &[[f64; 2]], count: usize) -> Vec<[f64; 2]> {
    let mean = |run: &[[f64; 2]]| {
        let n = run.len() as f64;
        [0, 1].map(|axis| run.iter().map(|point| point[axis]).sum::<f64>() / n)
    };
    points.chunks(points.len().div_ceil(count).max(1)).map(mean).collect()
}

/// A value in as few characters as tell it from its neighbours on an axis.
fn label(value: f64) -> String {
    let size = value.abs();
    if size >= 1e6 {
        return format!("{}M", short(value / 1e6));
    }
    if size >= 1e4 { format!("{}k", short(value / 1e3)) } else { short(value) }
}

fn short(value: f64) -> String {
    let digits = format!("{value:.6}");
    let trimmed = digits.trim_end_matches('0').trim_end_matches('.');
    if trimmed == "-0" { "0".into() } else { trimmed.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let axis = |low, high| Axis { low, high, from: 0.0, to: 1.0 }.ticks();
        assert_eq!(axis(0.0, 30_000.0), [0.0, 10_000.0, 20_000.0, 30_000.0]);
        assert_eq!(axis(1.0, 9.0), [2.0, 4.0, 6.0, 8.0]);
        assert_eq!([0.0, 12_000.0, 2_500_000.0, 0.25, -0.5].map(label), ["0", "12k", "2.5M", "0.25", "-0.5"]);
    }

    #[test]
    fn points_are_drawn_where_they_belong() {
        let points = vec![[0.0, 1.0], [10.0, 3.0]];
        let series = vec![Series { name: "loss".into(), points }];
        let text = Chart { caption: "c<".into(), x_name: "iteration", series }.render().into_string();
        // Low and left, then high and right.
        assert!(text.contains("d=\"M52.0 166.0L338.0 12.0\""), "{text}");
        assert!(text.contains("c&lt;"));
    }

    #[test]
    fn no_two_curves_look_alike() {
        let strokes: std::collections::HashSet<String> = (0..13).map(stroke).collect();
        assert_eq!(strokes.len(), 13, "as many arms as the largest preset has");
        let series = |name: &str| Series { name: name.into(), points: vec![[0.0, 1.0]; 2] };
        let chart = Chart { series: vec![series("one"), series("two")], ..Chart::default() };
        let text = chart.render().into_string();
        let legend = text.split_once("legend").expect("two curves need names").1;
        assert!(["one", "two", &stroke(1)].iter().all(|part| legend.contains(part)), "{text}");
    }

    #[test]
    fn a_constant_is_drawable_and_nothing_is_not() {
        let flat = Axis::around([5.0, 5.0].into_iter(), 0.0, 1.0);
        assert!(flat.low < 5.0 && flat.high > 5.0 && flat.at(5.0) == 0.5);
        assert!(Chart::default().render().into_string().is_empty(), "no curve, no chart");
    }

    #[test]
    fn thinning_averages_neighbours() {
        let points = [[1.0, 10.0], [3.0, 20.0], [5.0, 30.0]];
        assert_eq!(thinned(&points, 2), [[2.0, 15.0], [5.0, 30.0]]);
        assert_eq!(thinned(&points, 9), points);
        assert!(thinned(&[], 9).is_empty());
    }
}

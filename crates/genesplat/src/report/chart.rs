//! Curves as SVG.
//!
//! A chart is drawn 360 units wide, the width of a narrow screen, so that its labels are as large as the page's text
//! there; wider screens put several side by side.

use crate::report::html::Html;

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 200.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 22.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 34.0;
/// Between the middles of bars of one place.
const BAR_WIDTH: f64 = 5.0;
/// Ticks that an axis aims for.
const TICKS: f64 = 4.0;
/// Told apart by most eyes (Okabe and Ito); `style.css` has them for light and dark ground.
const COLOURS: [&str; 4] = ["var(--c0)", "var(--c1)", "var(--c2)", "var(--c3)"];
/// Lengths of strokes and gaps: where there are more curves than colours, the next four are dashed, and so on.
const DASHES: [&str; 4] = ["none", "7 3", "2 2", "9 2 2 2"];

/// A chart.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Chart {
    /// What it shows.
    pub(crate) caption: String,
    /// What is along the horizontal axis.
    pub(crate) x_name: String,
    /// The curves.
    pub(crate) series: Vec<Series>,
}

/// A curve.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Series {
    /// For the legend.
    pub(crate) name: String,
    /// From left to right.
    pub(crate) points: Vec<[f64; 2]>,
    /// Half the height of a band around each point; empty for none.
    pub(crate) spread: Vec<f64>,
    /// A bar from zero for each point, in place of a line through all of them.
    pub(crate) is_bars: bool,
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

impl Chart {
    /// Writes the chart as a figure; nothing where no curve has two points, and no bar is there.
    pub(crate) fn write(&self, page: &mut Html) {
        let is_empty = |series: &Series| series.points.len() < if series.is_bars { 1 } else { 2 };
        if self.series.iter().all(is_empty) {
            return;
        }
        let points = || self.series.iter().flat_map(|series| &series.points);
        let x = Axis::around(points().map(|point| point[0]), LEFT, WIDTH - RIGHT);
        let y = Axis::around(self.series.iter().flat_map(Series::reach), HEIGHT - BOTTOM, TOP);
        page.open("figure").element("figcaption", &self.caption);
        page.open(&format!("svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\""));
        page.element("title", &self.caption);
        self.write_axes(page, &x, &y);
        for (index, series) in self.series.iter().enumerate() {
            // Bars of one place stand side by side.
            let shift = BAR_WIDTH * (index as f64 - (self.series.len() - 1) as f64 / 2.0);
            series.write(page, &x, &y, index, shift);
        }
        page.close("svg");
        self.write_legend(page);
        page.close("figure");
    }

    fn write_axes(&self, page: &mut Html, x: &Axis, y: &Axis) {
        let bottom = HEIGHT - BOTTOM;
        for value in y.ticks() {
            let at = y.at(value);
            page.open(&format!("path class=\"grid\" d=\"M{LEFT} {at:.1}H{}\"/", WIDTH - RIGHT));
            let place = format!("text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\"", LEFT - 5.0, at + 4.0);
            page.element(&place, &label(value));
        }
        for value in x.ticks() {
            let at = x.at(value);
            page.open(&format!("path class=\"grid\" d=\"M{at:.1} {bottom}v4\"/"));
            let place = format!("text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\"", bottom + 15.0);
            page.element(&place, &label(value));
        }
        let middle = f64::midpoint(LEFT, WIDTH - RIGHT);
        let place = format!("text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\"", HEIGHT - 4.0);
        page.element(&place, &self.x_name);
    }

    /// Names of the curves, if there are several.
    fn write_legend(&self, page: &mut Html) {
        if self.series.len() < 2 {
            return;
        }
        page.open("ul class=\"legend\"");
        for (index, series) in self.series.iter().enumerate() {
            page.open("li").open("svg viewBox=\"0 0 24 8\" aria-hidden=\"true\"");
            let form = if series.is_bars { "bars" } else { "line" };
            page.open(&format!("path class=\"{form}\" style=\"{}\" d=\"M0 4H24\"/", stroke(index)));
            page.close("svg").element("span", &series.name).close("li");
        }
        page.close("ul");
    }
}

fn colour(index: usize) -> &'static str {
    COLOURS[index % COLOURS.len()]
}

/// What tells the curve of this index from the others.
fn stroke(index: usize) -> String {
    format!("stroke:{};stroke-dasharray:{}", colour(index), DASHES[index / COLOURS.len() % DASHES.len()])
}

impl Series {
    /// All heights that the curve and its band reach; bars begin at zero.
    fn reach(&self) -> impl Iterator<Item = f64> + '_ {
        let spread = self.spread.iter().copied().chain(std::iter::repeat(0.0));
        let heights = self.points.iter().zip(spread);
        let heights = heights.flat_map(|(point, spread)| [point[1] - spread, point[1] + spread]);
        heights.chain(self.is_bars.then_some(0.0))
    }

    fn write(&self, page: &mut Html, x: &Axis, y: &Axis, index: usize, shift: f64) {
        let path = |points: &mut dyn Iterator<Item = [f64; 2]>| {
            points.map(|[px, py]| format!("{:.1} {:.1}", x.at(px), y.at(py))).collect::<Vec<_>>().join("L")
        };
        if !self.spread.is_empty() {
            let band = || self.points.iter().zip(&self.spread);
            let mut outline = band()
                .map(|(point, spread)| [point[0], point[1] + spread])
                .chain(band().rev().map(|(point, spread)| [point[0], point[1] - spread]));
            page.open(&format!(
                "path class=\"band\" style=\"fill:{}\" d=\"M{}Z\"/",
                colour(index),
                path(&mut outline)
            ));
        }
        if self.is_bars {
            let bar = |point: &[f64; 2]| {
                format!("M{:.1} {:.1}V{:.1}", x.at(point[0]) + shift, y.at(0.0), y.at(point[1]))
            };
            let bars: String = self.points.iter().map(bar).collect();
            page.open(&format!("path class=\"bars\" style=\"stroke:{}\" d=\"{bars}\"/", colour(index)));
            return;
        }
        let line = path(&mut self.points.iter().copied());
        page.open(&format!("path class=\"line\" style=\"{}\" d=\"M{line}\"/", stroke(index)));
    }
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
        let series = vec![Series { name: "loss".into(), points, ..Series::default() }];
        let mut page = Html::new();
        Chart { caption: "c<".into(), x_name: "iteration".into(), series }.write(&mut page);
        let text = page.into_text();
        // Low and left, then high and right.
        assert!(text.contains("d=\"M52.0 166.0L338.0 12.0\""), "{text}");
        assert!(text.contains("c&lt;"));
    }

    #[test]
    fn bars_stand_on_zero() {
        let points = vec![[0.0, 0.0], [5.0, 0.5], [10.0, 1.0]];
        let series = vec![Series { points, is_bars: true, ..Series::default() }];
        let mut page = Html::new();
        Chart { series, ..Chart::default() }.write(&mut page);
        let text = page.into_text();
        assert!(text.contains("d=\"M52.0 166.0V166.0M195.0 166.0V89.0M338.0 166.0V12.0\""), "{text}");
    }

    #[test]
    fn no_two_curves_look_alike() {
        let strokes: std::collections::HashSet<String> = (0..13).map(stroke).collect();
        assert_eq!(strokes.len(), 13, "as many arms as the largest preset has");
        let series =
            |name: &str| Series { name: name.into(), points: vec![[0.0, 1.0]; 2], ..Series::default() };
        let mut page = Html::new();
        let chart = Chart { series: vec![series("one"), series("two")], ..Chart::default() };
        chart.write(&mut page);
        let text = page.into_text();
        let legend = text.split_once("legend").expect("two curves need names").1;
        assert!(["one", "two", &stroke(1)].iter().all(|part| legend.contains(part)), "{text}");
    }

    #[test]
    fn a_band_widens_the_axis_and_a_constant_is_drawable() {
        let points = vec![[0.0, 2.0], [1.0, 2.0]];
        let series = Series { points, spread: vec![1.0, 1.0], ..Series::default() };
        assert_eq!(series.reach().fold(0.0, f64::max), 3.0);
        let flat = Axis::around([5.0, 5.0].into_iter(), 0.0, 1.0);
        assert!(flat.low < 5.0 && flat.high > 5.0 && flat.at(5.0) == 0.5);
        let mut page = Html::new();
        Chart::default().write(&mut page);
        assert!(page.into_text().is_empty(), "no curve, no chart");
    }
}

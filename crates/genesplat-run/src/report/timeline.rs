//! What happens when, as a drawing: a row for each event, along the iterations.

use genesplat_train::timeline::{Event, Timeline, When};
use maud::{Markup, html};

use super::chart::tenths;
use crate::numbers::thousands;

const WIDTH: f64 = 720.0;
const LABELS: f64 = 190.0;
const RIGHT: f64 = 16.0;
const ROW: f64 = 22.0;
/// More of them are a bar.
const TICKS: usize = 48;

/// The section of a page.
pub(crate) fn section(timeline: &Timeline) -> Markup {
    let rows = rows(timeline);
    let height = ROW * (rows.len() + 1) as f64;
    html! {
        h2 { "Timeline" }
        figure {
            svg viewBox=(format!("0 0 {WIDTH} {height}")) role="img" {
                title { "What happens when" }
                @for (nth, (event, whens)) in rows.iter().enumerate() {
                    (row(*event, whens, timeline.iterations, ROW * (nth as f64 + 0.5)))
                }
                @for (part, anchor) in [(0.0, "start"), (0.5, "middle"), (1.0, "end")] {
                    @let i = (f64::from(timeline.iterations) * part).round();
                    @let [x, y] = [x_of(i, timeline.iterations), height - 6.0].map(tenths);
                    text x=(x) y=(y) text-anchor=(anchor) { (thousands(i as usize)) }
                }
            }
        }
    }
}

/// An event's name, and when it happens.
fn row(event: Event, whens: &[When], iterations: u32, y: f64) -> Markup {
    let drawn: String = whens.iter().map(|&when| drawn(when, iterations, y)).collect();
    html! {
        text x="0" y=(tenths(y + 4.0)) { (event.words()) }
        path.line style="stroke:var(--c0);stroke-width:2" d=(drawn) {}
    }
}

/// The events that happen at all but for steps, each with all that is planned of it.
fn rows(timeline: &Timeline) -> Vec<(Event, Vec<When>)> {
    let mut rows: Vec<(Event, Vec<When>)> = Vec::new();
    for &(event, when) in
        timeline.events().iter().filter(|(event, when)| *event != Event::Step && !when.is_never())
    {
        match rows.last_mut() {
            Some((last, whens)) if *last == event => whens.push(when),
            _ => rows.push((event, vec![when])),
        }
    }
    rows
}

fn x_of(i: f64, iterations: u32) -> f64 {
    LABELS + i / f64::from(iterations.max(1)) * (WIDTH - LABELS - RIGHT)
}

fn drawn(when: When, iterations: u32, y: f64) -> String {
    let x = |i: u32| x_of(f64::from(i), iterations);
    if when.iter().nth(TICKS).is_some() {
        return format!("M{:.1} {y:.1}H{:.1}", x(when.first), x(when.last));
    }
    when.iter().map(|i| format!("M{:.1} {:.1}v8", x(i), y - 4.0)).collect()
}

#[cfg(test)]
mod tests {
    use genesplat_train::{MethodName, TrainConfig};

    use super::*;

    #[test]
    fn each_event_has_a_row_and_few_are_ticks() {
        let schedule = TrainConfig::of(MethodName::ThreeDgs).resolve().unwrap();
        let text = section(schedule.timeline()).into_string();
        assert_eq!(text.matches("<path").count(), 2, "{text}");
        assert_eq!(text.matches("v8").count(), 4, "opacities are reset four times: {text}");
        assert!(
            text.contains("densify") && text.contains("opacity reset") && text.contains("30,000"),
            "{text}"
        );
    }
}

//! Everything as CSV, a line a cell.

use genesplat::io::shown;
use genesplat::run::metrics::Split;

use super::plan::Cell;
use super::results::{METRICS, Results};

const CELLS: &str = "scene,method,arm,seed,test_psnr,test_ssim,test_lpips,train_psnr,train_ssim,train_lpips,gaussians,iterations,\
                     gradient_seconds,evolution_seconds,folder";

pub(crate) fn cells(results: &Results<'_>) -> String {
    let experiment = results.experiment;
    let mut text = format!("{CELLS}\n");
    let finished = experiment.cells().into_iter().filter_map(|cell| Some((cell, results.get(cell)?)));
    for (cell, metrics) in finished {
        let Cell { scene, arm, seed, .. } = cell;
        let mut fields = vec![
            experiment.scene_name(scene).to_owned(),
            experiment.trained(cell).to_owned(),
            experiment.arms[arm].name.clone(),
            experiment.file.seeds[seed].to_string(),
        ];
        for split in Split::ALL {
            let scores = metrics.scores(split);
            fields.extend(METRICS.map(|metric| number(metric.of(scores))));
        }
        fields.extend([metrics.gaussians.to_string(), metrics.iterations.to_string()]);
        fields.extend([metrics.seconds.gradient, metrics.seconds.evolution].map(Some).map(number));
        fields.push(shown(experiment.folder(cell)));
        text += &csv_line(&fields);
    }
    text
}

/// Six digits are more than any of these figures deserve; nothing where there is none.
fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| format!("{value:.6}"))
}

/// Fields as RFC 4180 has them.
fn csv_line(fields: &[impl AsRef<str>]) -> String {
    let quote = |field: &str| {
        let plain = !field.contains([',', '"', '\n', '\r']);
        if plain { field.to_owned() } else { format!("\"{}\"", field.replace('"', "\"\"")) }
    };
    fields.iter().map(|field| quote(field.as_ref())).collect::<Vec<_>>().join(",") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_with_commas_and_quotes_are_quoted() {
        assert_eq!(csv_line(&["a", "b,c", "say \"x\""]), "a,\"b,c\",\"say \"\"x\"\"\"\n");
        assert_eq!((number(None), number(Some(-0.5))), (String::new(), "-0.500000".into()));
    }
}

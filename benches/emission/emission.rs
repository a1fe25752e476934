//! The engine's side of the bench: `run` calls it with a folder of samples. One line of JSON a task.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use firn_science::emission::correlation::{CorrelationOptions, correlation_integral};
use firn_science::emission::goodness::{Question, p_value};
use firn_science::emission::sample::Sample;
use firn_science::emission::tails::{KsConvention, Model, Tail, fit};
use firn_science::emission::xmin::scan;
use firn_science::progress::Unobserved;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let folder = std::env::args().nth(1).ok_or("usage: emission FOLDER")?;
    let folder = Path::new(&folder);
    for name in ["pareto_100k", "body_5k", "cutoff_10k"] {
        let values = read(&folder.join(format!("{name}.txt")))?;
        let start = Instant::now();
        let found = scan(&values, KsConvention::Csn)?;
        let seconds = start.elapsed().as_secs_f64();
        println!(
            r#"{{"task": "scan {name}", "seconds": {seconds}, "result": [{}, {}, {}]}}"#,
            found.xmin, found.alpha, found.ks_distance
        );
    }
    fits(&read(&folder.join("cutoff_10k.txt"))?)?;
    goodness(read(&folder.join("body_5k.txt"))?)?;
    correlation(&folder.join("points_50k.txt"))
}

fn read(path: &Path) -> Outcome<Vec<f64>> {
    let mut values = std::fs::read_to_string(path)?.lines().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    values.sort_by(f64::total_cmp);
    Ok(values)
}

/// Parameters in the order of the peer's result.
fn fits(values: &[f64]) -> Outcome<()> {
    let tail = Tail::exact(values, values[0], None)?;
    for (model, names) in [
        (Model::PowerLaw, vec!["alpha"]),
        (Model::CutoffPowerLaw, vec!["alpha", "cutoff"]),
        (Model::Exponential, vec!["rate"]),
        (Model::Lognormal, vec!["log_mean", "log_sd"]),
        (Model::StretchedExponential, vec!["rate", "stretching"]),
    ] {
        let start = Instant::now();
        let fitted = fit(&tail, model)?;
        let seconds = start.elapsed().as_secs_f64();
        let parameters: Vec<f64> = names.iter().filter_map(|name| fitted.parameter(name)).map(|p| p.value).collect();
        let (name, loglik) = (model.name(), fitted.loglik);
        println!(r#"{{"task": "fit {name}", "seconds": {seconds}, "result": {parameters:?}, "loglik": {loglik}}}"#);
    }
    Ok(())
}

fn goodness(values: Vec<f64>) -> Outcome<()> {
    let found = scan(&values, KsConvention::Csn)?;
    let sample = Sample::Exact(values);
    let fitted = fit(&sample.tail(Some(found.xmin), None)?, Model::PowerLaw)?;
    let convention = KsConvention::Csn;
    let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: true, xmax: None, convention };
    let start = Instant::now();
    let answer = p_value(&question, 2500, 1, &Unobserved)?;
    let seconds = start.elapsed().as_secs_f64();
    println!(r#"{{"task": "p, 2500 replicates", "seconds": {seconds}, "result": [{}]}}"#, answer.p_value);
    Ok(())
}

/// With all that the analysis does: null, interior, dimension and its error.
fn correlation(path: &Path) -> Outcome<()> {
    let numbers = std::fs::read_to_string(path)?;
    let numbers = numbers.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    let points: Vec<[f64; 3]> = numbers.as_chunks::<3>().0.to_vec();
    let options = CorrelationOptions { r_min_m: Some(1e-3), r_max_m: Some(1.8), ..Default::default() };
    let start = Instant::now();
    let found = correlation_integral(&points, None, None, &options, &Unobserved)?;
    let seconds = start.elapsed().as_secs_f64();
    let pairs: Vec<u64> = found.points.iter().map(|point| point.pairs).collect();
    let radii: Vec<f64> = found.points.iter().map(|point| point.r_m).collect();
    println!(r#"{{"task": "C(r), 40 radii", "seconds": {seconds}, "result": {pairs:?}, "radii": {radii:?}}}"#);
    Ok(())
}

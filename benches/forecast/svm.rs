//! The firn side of the comparison with scikit-learn: one JSON line with the keys of `svm_sklearn.py`.
//!
//! usage: svm SET.csv (see `benches/forecast/README.md`; `cargo bench` without a set does nothing).
#![expect(clippy::print_stdout, reason = "its output is what a bench is for")]

use std::error::Error;
use std::time::Instant;

use firn_science::forecast::matrix::Matrix;
use firn_science::forecast::svm::{
    Cost, EliminationRecipe, Grid, Kernel, KernelFamily, SolverOptions, eliminate, grid_search, train,
};
use firn_science::forecast::verification::auc;
use firn_science::progress::Unobserved;
use rayon::prelude::*;

const FITS: [(f64, f64); 5] = [(1.0, 0.003), (1.0, 0.01), (10.0, 0.003), (10.0, 0.01), (10.0, 0.03)];

struct Set {
    x: Matrix,
    labels: Vec<bool>,
    fold: Vec<usize>,
}

fn read(path: &str) -> Result<Set, Box<dyn Error>> {
    let (mut data, mut labels, mut fold) = (Vec::new(), Vec::new(), Vec::new());
    for line in std::fs::read_to_string(path)?.lines().filter(|line| !line.starts_with('#')) {
        let row = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        let [label, part, features @ ..] = row.as_slice() else { return Err("a row without features".into()) };
        labels.push(*label > 0.5);
        fold.push(*part as usize);
        data.extend_from_slice(features);
    }
    let columns = data.len() / labels.len().max(1);
    let x = Matrix::from_rows(labels.len(), columns, data).ok_or("rows of different lengths")?;
    Ok(Set { x, labels, fold })
}

fn fit(set: &Set, c: f64, gamma: f64) -> Result<String, Box<dyn Error>> {
    let cost = Cost::balanced(c, &set.labels);
    let start = Instant::now();
    let machine = train(&set.x, &set.labels, Kernel::Gaussian { gamma }, cost, &SolverOptions::default())?;
    let seconds = start.elapsed().as_secs_f64();
    let decision: Vec<f64> = (0..set.x.rows()).map(|i| machine.decision_value(set.x.row(i))).collect();
    Ok(format!(
        r#"{{"c":{c},"gamma":{gamma},"seconds":{seconds},"iterations":{},"decision":{decision:?}}}"#,
        machine.iterations
    ))
}

/// Elimination down to one feature on all rows, and without each fold, which is scored at every size: the curve, and the
/// order on all rows.
fn elimination(set: &Set) -> Result<String, Box<dyn Error>> {
    // the tolerance of scikit-learn
    let options = SolverOptions { epsilon: 1e-3, ..SolverOptions::default() };
    let recipe = EliminationRecipe { c: 1.0, gamma: 0.01, least: 1 };
    let folds = set.fold.iter().max().map_or(0, |&last| last + 1);
    let start = Instant::now();
    let splits: Vec<Option<usize>> = std::iter::once(None).chain((0..folds).map(Some)).collect();
    let runs: Vec<(Vec<usize>, Vec<f64>)> = splits
        .into_par_iter()
        .with_max_len(1)
        .map(|held_out| {
            let (training, test): (Vec<usize>, Vec<usize>) =
                (0..set.labels.len()).partition(|&i| Some(set.fold[i]) != held_out);
            let of = |rows: &[usize]| rows.iter().map(|&i| set.labels[i]).collect::<Vec<bool>>();
            let (x, other) = (set.x.select_rows(&training), set.x.select_rows(&test));
            let found = eliminate(&x, &of(&training), &other, &recipe, &options, &Unobserved)?;
            let event = of(&test);
            let scores = found.decision_values.iter().map(|values| auc(values, &event).unwrap_or(f64::NAN)).collect();
            Ok((found.removed, scores))
        })
        .collect::<Result<_, firn_science::forecast::svm::EliminationError>>()?;
    let seconds = start.elapsed().as_secs_f64();
    let sizes = runs.last().map_or(0, |(_, scores)| scores.len());
    let mean = |size: usize| runs[1..].iter().map(|(_, scores)| scores[size]).sum::<f64>() / folds as f64;
    let curve: Vec<f64> = (0..sizes).map(mean).collect();
    Ok(format!(r#""rfe_seconds":{seconds},"curve":{curve:?},"removed":{:?}"#, runs[0].0))
}

fn main() -> Result<(), Box<dyn Error>> {
    let Some(path) = std::env::args().skip(1).find(|argument| !argument.starts_with('-')) else { return Ok(()) };
    let set = read(&path)?;
    let fits = FITS.iter().map(|&(c, gamma)| fit(&set, c, gamma)).collect::<Result<Vec<_>, _>>()?.join(",");
    let (options, family) = (SolverOptions::default(), KernelFamily::Gaussian);
    let start = Instant::now();
    let result = grid_search(&set.x, &set.labels, &set.fold, family, &Grid::default(), &options, &Unobserved)?;
    let seconds = start.elapsed().as_secs_f64();
    let auc: Vec<f64> = result.points.iter().map(|point| point.auc).collect();
    let elimination = elimination(&set)?;
    println!(
        r#"{{"version":"firn {}","fits":[{fits}],"grid_seconds":{seconds},"auc":{auc:?},{elimination}}}"#,
        env!("CARGO_PKG_VERSION")
    );
    Ok(())
}

//! How long a whole training run takes: nested evaluation, forward chaining and the final model, on 14 synthetic winters (about
//! the size of the Lochaber archive). Run with `cargo bench -p firn-science --bench train`; the time scales with the cores.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::error::Error;
use std::time::Instant;

use firn_science::forecast::day::Label;
use firn_science::forecast::features::FeatureSetId;
use firn_science::forecast::model::{FeatureChoice, TrainingOptions, train};
use firn_science::forecast::svm::{Grid, KernelFamily};
use firn_science::forecast::synthetic::{REPORTED, synthetic_station};
use firn_science::forecast::verification::ThresholdRule;
use firn_science::progress::Unobserved;

fn main() -> Result<(), Box<dyn Error>> {
    let days = synthetic_station(1, 1993, 14);
    let options = TrainingOptions {
        label: Label::Observed,
        lead: 0,
        feature_set: FeatureSetId::Expert,
        features: FeatureChoice::All,
        kernel: KernelFamily::Gaussian,
        reported: REPORTED.to_vec(),
        seed: 1,
        grid: Grid::default(),
        threshold: ThresholdRule::Peirce,
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in [1, cores] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let start = Instant::now();
        let trained = pool.install(|| train(&days, &options, &Unobserved))?;
        let seconds = start.elapsed().as_secs_f64();
        println!("train, {} days, {threads} thread(s): {seconds:.2} s", trained.evaluation.days);
    }
    Ok(())
}

//! The reproduction of the forecasting engine on the archive of Lochaber as a report in Markdown: what `docs/reproduction.md` is.
//!
//! usage: cargo run -p firn-science --example reproduction [decoded archive.csv] > docs/reproduction.md
//! (without a file: `sais_lochaber_1993-2007_decoded.csv` in `FIRN_SHARED_DATA` or `../shared/data`)
#![expect(clippy::print_stdout, reason = "the report goes to the terminal")]

use std::error::Error;
use std::fmt::Write as _;

use firn_science::forecast::day::{Activity, DayRecord, Label, Variable};
use firn_science::forecast::evaluation::{Evaluation, PerModel};
use firn_science::forecast::features::FeatureSetId;
use firn_science::forecast::model::{FeatureChoice, TrainingOptions, train};
use firn_science::forecast::selection::{FeatureSelection, select};
use firn_science::forecast::svm::{Grid, KernelFamily};
use firn_science::forecast::verification::{Scores, ThresholdRule};
use firn_science::progress::Unobserved;

/// Columns of the decoded archive, the variable each becomes and the factor to its unit.
const COLUMNS: [(&str, Variable, f64); 11] = [
    ("air_temp_c", Variable::AirTemperature, 1.0),
    ("wind_speed_mph", Variable::WindSpeed, 0.447_04),
    ("wind_dir_deg", Variable::WindDirection, 1.0),
    ("cloud_pct", Variable::CloudCover, 1.0),
    ("snow_index", Variable::NewSnowIndex, 1.0),
    ("rain_900", Variable::RainAt900m, 1.0),
    ("drift", Variable::SnowDrift, 1.0),
    ("foot_pen_cm", Variable::FootPenetration, 1.0),
    ("snow_temp_c", Variable::SnowTemperature, 1.0),
    ("insolation", Variable::InsolationIndex, 1.0),
    ("no_settle", Variable::CumulativeSnowIndex, 1.0),
];

/// The number of features that the paper kept.
const OF_THE_PAPER: usize = 44;

fn read(path: &str) -> Result<Vec<DayRecord>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().ok_or("an empty file")?.split(',').collect();
    let at = |name: &str| header.iter().position(|&column| column == name).ok_or(format!("no column {name}"));
    let day = |line: &str| -> Result<DayRecord, Box<dyn Error>> {
        let fields: Vec<&str> = line.split(',').collect();
        let mut day = DayRecord::empty(fields[at("date")?].parse()?);
        for (name, variable, factor) in COLUMNS {
            let field = fields[at(name)?];
            day.values[variable.index()] = if field.is_empty() { None } else { Some(field.parse::<f64>()? * factor) };
        }
        day.activity = match (fields[at("aval_observed")?], fields[at("aval_presumed")?]) {
            ("1", _) => Activity::Observed,
            (_, "1") => Activity::Presumed,
            ("0", "0") => Activity::None,
            _ => Activity::Unknown,
        };
        Ok(day)
    };
    lines.map(day).collect()
}

fn options(label: Label, lead: u8) -> TrainingOptions {
    TrainingOptions {
        label,
        lead,
        feature_set: FeatureSetId::Expert,
        features: FeatureChoice::All,
        kernel: KernelFamily::Gaussian,
        reported: COLUMNS.map(|(_, variable, _)| variable).to_vec(),
        seed: 1,
        grid: Grid::default(),
        threshold: ThresholdRule::Peirce,
    }
}

fn cell(score: Option<f64>) -> String {
    score.map_or_else(|| "-".to_owned(), |score| format!("{score:.3}"))
}

const NAMES: PerModel<&str> = PerModel {
    svm: "**support vector machine**",
    climatology: "climatology",
    persistence: "persistence",
    knn10: "10 nearest neighbours, variables of the day",
    knn30: "30 nearest neighbours, all features",
    logistic: "logistic regression",
};

fn table(scores: &PerModel<Scores>) -> String {
    let mut text =
        String::from("| model | AUC | PSS | HSS | Brier skill | POD | FAR |\n|---|---|---|---|---|---|---|\n");
    let rows = NAMES.named().into_iter().zip(scores.named());
    // the machine last, below what it is compared with
    let (machine, others): (Vec<_>, Vec<_>) = rows.partition(|((name, _), _)| *name == "svm");
    for ((_, name), (_, scores)) in others.into_iter().chain(machine) {
        let cells = [scores.auc, scores.pss, scores.hss, scores.brier_skill, scores.pod, scores.far].map(cell);
        let _ = writeln!(text, "| {name} | {} |", cells.join(" | "));
    }
    text
}

fn section(title: &str, evaluation: &Evaluation) -> String {
    let mut text = format!(
        "## {title}\n\n{} days of {} seasons, {} avalanche days (base rate {:.3}), every season left out once.\n\n{}\n",
        evaluation.days,
        evaluation.seasons,
        evaluation.events,
        evaluation.base_rate,
        table(&evaluation.scores)
    );
    let auc: Vec<f64> = evaluation.per_season.iter().filter_map(|season| season.scores.svm.auc).collect();
    let (least, most) = auc.iter().fold((1.0_f64, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
    let _ = writeln!(text, "AUC of the machine by season: {least:.2} to {most:.2}.");
    if let Some(difference) = &evaluation.bootstrap.svm_minus_knn30_auc {
        let _ = writeln!(
            text,
            "Machine minus 30 nearest neighbours in AUC: {:+.3} ({:+.3} to {:+.3}, 95 % of {} bootstraps over seasons).",
            difference.estimate, difference.lower, difference.upper, evaluation.bootstrap.replicates
        );
    }
    if let Some(chain) = &evaluation.forward_chaining {
        let scores = &chain.scores.svm;
        let _ = writeln!(
            text,
            "Forward chaining ({} seasons, {} days), the machine: AUC {}, PSS {}, HSS {}, Brier skill {}, POD {}, FAR {}.",
            chain.seasons.len(),
            chain.days,
            cell(scores.auc),
            cell(scores.pss),
            cell(scores.hss),
            cell(scores.brier_skill),
            cell(scores.pod),
            cell(scores.far)
        );
    }
    text
}

fn selection(found: &FeatureSelection) -> String {
    let mut text = String::from("## How many features it takes\n\n");
    let _ = writeln!(
        text,
        "Recursive elimination of the features of `expert`, label observed, lead 0; {} groups of seasons are held out in turn, and \
         all that is learnt is learnt without them. Best: {} features; smallest number within one standard error: {}.\n",
        found.groups.len(),
        found.best,
        found.proposed
    );
    text.push_str("| features | AUC | standard error |\n|---|---|---|\n");
    let sizes = [1, 2, 3, 5, 8, 10, 15, 20, 30, 40, OF_THE_PAPER, 50, 64, found.best, found.proposed];
    for score in found.curve.iter().filter(|score| sizes.contains(&score.features)) {
        let _ = writeln!(text, "| {} | {:.3} | {} |", score.features, score.auc, cell(score.standard_error));
    }
    let groups = found.groups.len();
    let listed = |names: &[String]| names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let _ = writeln!(
        text,
        "\nThe proposed features, the one that stayed longest first, and in how many of the {groups} groups each is among as many:\n"
    );
    for ranked in found.ranking.iter().take(found.proposed) {
        let _ = writeln!(text, "- `{}` ({} of {groups})", ranked.feature, ranked.groups);
    }
    let _ = writeln!(text, "\nThe {OF_THE_PAPER} that stayed longest: {}.", listed(&found.set(OF_THE_PAPER)));
    text
}

/// The claims of the study on what the elimination kept, against what it keeps here.
fn claims(found: &FeatureSelection) -> String {
    let kept = found.set(OF_THE_PAPER);
    let rank = |name: &str| found.ranking.iter().position(|ranked| ranked.feature == name).map(|at| at + 1);
    let raw = |lag: &str| -> Vec<String> {
        COLUMNS
            .iter()
            .map(|(_, variable, _)| format!("{}_{lag}", variable.name()))
            .filter(|name| rank(name).is_some())
            .collect()
    };
    let survivors = |lag: &str| raw(lag).into_iter().filter(|name| kept.contains(name)).collect::<Vec<_>>();
    let mut text = String::from("## Does what the study says of its features hold here?\n\n");
    let _ = writeln!(
        text,
        "The study kept {OF_THE_PAPER} features, of whose raw variables of two days before only foot penetration and wind direction \
         were left, and of whose derived ones those of south and south-east wind stood out. Its list cannot be compared feature by \
         feature: the features here are not its own, there are {} of them, and the archive is the same service's but not its file.\n",
        found.ranking.len()
    );
    text.push_str("| day | raw variables | among the 44 | which |\n|---|---|---|---|\n");
    for (day, lag) in [("t", "t"), ("t-1", "t1"), ("t-2", "t2")] {
        let (all, left) = (raw(lag), survivors(lag));
        let names = left.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let _ = writeln!(text, "| {day} | {} | {} | {names} |", all.len(), left.len());
    }
    text.push_str("\nRanks (1 stayed longest) of the raw variables of t-2: ");
    let mut ranks: Vec<(usize, String)> = raw("t2").into_iter().filter_map(|name| Some((rank(&name)?, name))).collect();
    ranks.sort();
    text.push_str(&ranks.iter().map(|(rank, name)| format!("`{name}` {rank}")).collect::<Vec<_>>().join(", "));
    text.push_str(".\n\nRanks of the derived features of the wind: ");
    let of_wind = |name: &str| {
        name.starts_with("wind_")
            && !COLUMNS
                .iter()
                .any(|(_, v, _)| name.strip_prefix(v.name()).is_some_and(|rest| ["_t", "_t1", "_t2"].contains(&rest)))
    };
    let winds: Vec<String> = found
        .ranking
        .iter()
        .enumerate()
        .filter(|(_, ranked)| of_wind(&ranked.feature))
        .map(|(at, ranked)| format!("`{}` {}", ranked.feature, at + 1))
        .collect();
    let _ = writeln!(text, "{}.\n", winds.join(", "));
    let only = ["foot_penetration_t2", "wind_direction_t2"];
    let left = survivors("t2");
    let holds = left.len() == only.len() && only.iter().all(|name| left.iter().any(|kept| kept == name));
    let verdict = if holds { "holds" } else { "does not hold" };
    let both = only.iter().filter(|name| left.iter().any(|kept| kept == *name)).count();
    if let Some((first, _)) = winds.first().and_then(|wind| wind.rsplit_once(' ')) {
        let _ = writeln!(text, "Of the derived features of the wind {first} stayed longest.\n");
    }
    let _ = writeln!(
        text,
        "That only foot penetration and wind direction of t-2 survive **{verdict}** here: {} of {} raw variables of t-2 are among the \
         {OF_THE_PAPER} ({} of t-1 and {} of t are), {both} of those two with them.",
        left.len(),
        raw("t2").len(),
        survivors("t1").len(),
        survivors("t").len()
    );
    text
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::var("FIRN_SHARED_DATA").unwrap_or_else(|_| "../shared/data".to_owned());
    let path = std::env::args().nth(1).unwrap_or_else(|| format!("{folder}/sais_lochaber_1993-2007_decoded.csv"));
    let days = read(&path)?;
    println!(
        "# Reproduction on the archive of Lochaber\n\nMade by `cargo run -p firn-science --example reproduction`; {} days of the \
         Scottish service's public daily archive, {} to {}. The archive is not part of this repository. Nothing was tuned to \
         it: grid, folds and features are the defaults.\n",
        days.len(),
        days.first().map_or_else(String::new, |day| day.date.to_string()),
        days.last().map_or_else(String::new, |day| day.date.to_string())
    );
    for (title, label, lead) in [
        ("Label observed, lead 0 (nowcast)", Label::Observed, 0),
        ("Label observed, lead 1 (tomorrow)", Label::Observed, 1),
        ("Label presumed, lead 0 (nowcast)", Label::Presumed, 0),
    ] {
        println!("{}", section(title, &train(&days, &options(label, lead), &Unobserved)?.evaluation));
    }
    let found = select(&days, &options(Label::Observed, 0), &Unobserved)?;
    println!("{}\n{}", selection(&found), claims(&found));
    Ok(())
}

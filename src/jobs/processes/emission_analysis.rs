//! The process `emission-analysis`: a data set of acoustic emission and a list of analyses in, their results and figures out.

use firn_science::{
    emission::{
        aftershocks::AftershockOptions,
        analysis::{
            self, ActivityOptions, CalibrationOptions, DistributionOptions, MapOptions, PhaseOptions, Request,
            ValidationOptions, WaitingOptions,
        },
        catalogue::Catalogue,
        correlation::CorrelationOptions,
        duration::DurationOptions,
        source::SourceOptions,
    },
    progress::Progress,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Value, json};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, Failure, Shelf,
    emission::{self, Unpacked},
    invalid_inputs,
};
use crate::{
    domain::{
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    formats::figures,
    jobs::link::{Artifact, Output},
};

pub use super::emission::{Figures, Head};

/// Its id in every address.
pub const ID: &str = "emission-analysis";

/// Most analyses of one job.
const MOST_ANALYSES: usize = 50;

/// What to analyse, and how.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// Id of the data set.
    pub dataset: Uuid,
    /// The analyses, 1 to 50; each has a `kind` and the options of that kind.
    #[schema(value_type = Vec<Request>, min_items = 1, max_items = 50)]
    pub analyses: Vec<Value>,
    /// Seed of everything random; the same seed gives the same bits.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0)]
    pub seed: u64,
    /// Figures of the results: `none`, `svg`, `png` or `both`.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(none|svg|png|both)$", default = "svg")]
    pub figures: Figures,
}

/// The inputs once they were read in full.
#[derive(Serialize, Deserialize)]
struct Complete {
    dataset: Uuid,
    analyses: Vec<Request>,
    seed: u64,
    figures: Figures,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Analyse acoustic emission of dislocation avalanches",
        description: "Runs a list of analyses on a data set: distributions of amplitudes and energies with fit, goodness of \
                      fit and comparison of models, durations and damping, correlation integral, waiting times, aftershocks, \
                      activity, exponent maps, Monte-Carlo validation, source model, calibration, loading against unloading; \
                      with figures (docs/emission.md).",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "dataset": {"title": "What was analysed", "schema": {"type": "object"}},
            "analyses": {"title": "The result of each analysis, in their order", "schema": {"type": "array"}},
            "figures": {"title": "The figures, and the outputs that hold them", "schema": {"type": "array"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {
            "dataset": "019326f0-0000-7000-8000-000000000000",
            "analyses": [{"kind": "amplitude_distribution", "model": "auto"}, {"kind": "duration_scaling"}],
            "seed": 1,
        }}),
    }
}

/// Checks the inputs against their schema, and the analyses against the data set.
pub(super) async fn accept(shelf: Shelf<'_>, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let analyses = requests(&read.analyses).map_err(invalid_inputs)?;
    if let Some(fault) = emission::check_seed(read.seed) {
        return Err(invalid_inputs(vec![fault]));
    }
    let opened = emission::open(shelf, read.dataset, "/inputs/dataset").await?;
    let faults = refusals(&opened.catalogue()?, &analyses);
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let complete = Complete { dataset: read.dataset, analyses, seed: read.seed, figures: read.figures };
    let inputs = serde_json::to_value(&complete).map_err(Problem::internal)?;
    Ok(Accepted { hash: emission::hash(&inputs, &[&opened.head]), inputs })
}

/// The analyses of the inputs, or every field of them that is at fault.
///
/// # Errors
/// The fields at fault; at least one.
pub fn requests(analyses: &[Value]) -> Result<Vec<Request>, Vec<FieldError>> {
    if !(1..=MOST_ANALYSES).contains(&analyses.len()) {
        let detail = format!("must be 1 to {MOST_ANALYSES} analyses, not {}", analyses.len());
        return Err(vec![FieldError::new("/inputs/analyses", "wrong_length", detail)]);
    }
    let (mut requests, mut faults) = (Vec::new(), Vec::new());
    for (at, analysis) in analyses.iter().enumerate() {
        match request(analysis, &format!("/inputs/analyses/{at}")) {
            Ok(request) => requests.push(request),
            Err(found) => faults.extend(found),
        }
    }
    if faults.is_empty() { Ok(requests) } else { Err(faults) }
}

/// Names of all analyses.
pub const KINDS: [&str; 12] = [
    "amplitude_distribution",
    "energy_distribution",
    "duration_scaling",
    "correlation_integral",
    "waiting_times",
    "aftershocks",
    "activity",
    "exponent_map",
    "monte_carlo_validation",
    "source_model",
    "calibration",
    "phase_comparison",
];

fn request(analysis: &Value, at: &str) -> Result<Request, Vec<FieldError>> {
    let Some(members) = analysis.as_object() else {
        return Err(vec![FieldError::new(at, "wrong_type", "must be an object with a `kind`")]);
    };
    let mut options = members.clone();
    let kind = options.remove("kind").unwrap_or(Value::Null);
    let options = Value::Object(options);
    Ok(match kind.as_str().unwrap_or_default() {
        "amplitude_distribution" => Request::AmplitudeDistribution(of::<DistributionOptions>(&options, at)?),
        "energy_distribution" => Request::EnergyDistribution(of::<DistributionOptions>(&options, at)?),
        "duration_scaling" => Request::DurationScaling(of::<DurationOptions>(&options, at)?),
        "correlation_integral" => Request::CorrelationIntegral(of::<CorrelationOptions>(&options, at)?),
        "waiting_times" => Request::WaitingTimes(of::<WaitingOptions>(&options, at)?),
        "aftershocks" => Request::Aftershocks(of::<AftershockOptions>(&options, at)?),
        "activity" => Request::Activity(of::<ActivityOptions>(&options, at)?),
        "exponent_map" => Request::ExponentMap(of::<MapOptions>(&options, at)?),
        "monte_carlo_validation" => Request::MonteCarloValidation(of::<ValidationOptions>(&options, at)?),
        "source_model" => Request::SourceModel(of::<SourceOptions>(&options, at)?),
        "calibration" => Request::Calibration(of::<CalibrationOptions>(&options, at)?),
        "phase_comparison" => Request::PhaseComparison(of::<PhaseOptions>(&options, at)?),
        _ => {
            let detail = format!("must be one of {}, not {kind}", KINDS.join(", "));
            return Err(vec![FieldError::new(format!("{at}/kind"), "not_in_list", detail)]);
        }
    })
}

fn of<T: DeserializeOwned + ToSchema + 'static>(options: &Value, at: &str) -> Result<T, Vec<FieldError>> {
    schema::read(options, at)
}

/// Why analyses cannot be run on a catalogue, as far as that is known beforehand.
#[must_use]
pub fn refusals(catalogue: &Catalogue, analyses: &[Request]) -> Vec<FieldError> {
    let refusal = |(at, request): (usize, &Request)| {
        let refused = analysis::check(catalogue, std::slice::from_ref(request)).err()?;
        let at = format!("/inputs/analyses/{at}");
        Some(emission::field_error(&refused.error, &at, &at))
    };
    analyses.iter().enumerate().filter_map(refusal).collect()
}

/// The hits as they were taken in, with the metadata as they are now.
pub(super) async fn payload(shelf: Shelf<'_>, job: &Job) -> Result<Vec<u8>, Problem> {
    let inputs: Complete = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let opened = emission::open(shelf, inputs.dataset, "/inputs/dataset").await.map_err(emission::gone)?;
    emission::pack(job, vec![opened])
}

/// Analyses and draws.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let unpacked: Unpacked<Complete> = emission::unpack(payload)?;
    let Unpacked { inputs, heads, catalogues, mut provenance, .. } = unpacked;
    let (Some(head), Some(catalogue)) = (heads.first(), catalogues.first()) else {
        return Err(Failure::Science("there is no data set".into()));
    };
    provenance["seed"] = json!(inputs.seed);
    let Found { analyses, figures, artifacts } =
        analyse(catalogue, head, &inputs.analyses, inputs.seed, inputs.figures, progress)?;
    let results = json!({"dataset": head, "analyses": analyses, "figures": figures, "provenance": provenance});
    Ok(Output { results, artifacts, ..Output::default() })
}

/// What the analyses of a data set give.
#[derive(Debug)]
pub struct Found {
    /// The result of each analysis.
    pub analyses: Value,
    /// What the figures show, and which artifacts they are.
    pub figures: Value,
    /// The figures.
    pub artifacts: Vec<Artifact>,
}

/// Runs analyses and draws their figures: the same for a job and for the command line.
///
/// # Errors
/// [`Failure`].
pub fn analyse(
    catalogue: &Catalogue,
    head: &Head,
    requests: &[Request],
    seed: u64,
    wanted: Figures,
    progress: &dyn Progress,
) -> Result<Found, Failure> {
    let outcomes = analysis::run(catalogue, requests, seed, progress).map_err(emission::failure)?;
    let mut drawings = Vec::new();
    for (at, outcome) in outcomes.iter().enumerate() {
        drawings.extend(figures::of_outcome(&format!("{at}-"), outcome, &head.name, head.synthetic));
    }
    let (artifacts, figures) = emission::drawn(&drawings, wanted)?;
    let analyses = serde_json::to_value(&outcomes).map_err(emission::science)?;
    Ok(Found { analyses, figures, artifacts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_known_by_its_name() {
        for kind in KINDS {
            let read = request(&json!({"kind": kind}), "/inputs/analyses/0").unwrap();
            assert_eq!(read.kind(), kind);
            // what the job keeps is read again by the worker
            let kept = serde_json::to_value(&read).unwrap();
            assert_eq!(serde_json::from_value::<Request>(kept).unwrap(), read);
        }
    }

    #[test]
    fn faults_of_an_analysis_are_pointed_at() {
        let faults = requests(&[
            json!({"kind": "amplitude_distribution", "model": "gauss"}),
            json!({"kind": "wavelets"}),
            json!({"kind": "duration_scaling", "bins": 3}),
            json!(7),
        ])
        .unwrap_err();
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(
            pointers,
            ["/inputs/analyses/0/model", "/inputs/analyses/1/kind", "/inputs/analyses/2/bins", "/inputs/analyses/3"]
        );
        assert!(faults[0].detail.contains("cutoff_power_law"), "{faults:?}");
    }

    #[test]
    fn the_published_schema_takes_what_the_reader_takes() {
        let schema = schema::schema_of::<Inputs>();
        let validator = jsonschema::validator_for(&schema).unwrap();
        let with = |analysis: Value| json!({"dataset": "019326f0-0000-7000-8000-000000000000", "analyses": [analysis]});
        for kind in KINDS {
            assert!(validator.is_valid(&with(json!({"kind": kind}))), "{kind}");
            assert!(!validator.is_valid(&with(json!({"kind": kind, "unheard": 1}))), "{kind}");
        }
        assert!(validator.is_valid(&with(json!({"kind": "amplitude_distribution", "model": "auto", "xmin": 0.003}))));
        assert!(!validator.is_valid(&with(json!({"kind": "wavelets"}))));
        assert!(!schema.to_string().contains("$ref"), "a description stands alone");
    }
}

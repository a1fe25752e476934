//! The process `emission-comparison`: several data sets of acoustic emission in; collapse, tests of one exponent and one
//! distribution, and how cut-off and damping go with grain size and temperature out.

use firn_science::{
    emission::{
        analysis::compare::{self, ComparisonOptions, MOST_SETS},
        catalogue::Catalogue,
    },
    progress::Progress,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, Failure, Shelf,
    emission::{self, Figures, Opened, Unpacked},
    invalid_inputs,
};
use crate::{
    domain::{
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    formats::figures,
    jobs::link::Output,
};

/// Its id in every address.
pub const ID: &str = "emission-comparison";

/// What to compare, and how.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// Ids of 2 to 50 data sets.
    #[schema(min_items = 2, max_items = 50)]
    pub datasets: Vec<Uuid>,
    /// How they are compared.
    #[serde(default)]
    #[schema(inline)]
    pub options: ComparisonOptions,
    /// Seed of everything random; the same seed gives the same bits.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0)]
    pub seed: u64,
    /// Figures of the results: `none`, `svg`, `png` or `both`.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(none|svg|png|both)$", default = "svg")]
    pub figures: Figures,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Compare data sets of acoustic emission",
        description: "Fits every data set, collapses n(A)/N, tests whether all share one exponent (with and without cut-offs \
                      of their own) and one distribution, and draws cut-off, damping and exponent against grain size, \
                      temperature and stress.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "datasets": {"title": "What was compared", "schema": {"type": "array"}},
            "comparison": {"title": "What was found", "schema": {"type": "object"}},
            "figures": {"title": "The figures, and the outputs that hold them", "schema": {"type": "array"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"datasets": [
            "019326f0-0000-7000-8000-000000000000", "019326f0-0000-7000-8000-000000000001",
        ]}}),
    }
}

async fn open_all(shelf: Shelf<'_>, ids: &[Uuid]) -> Result<Vec<Opened>, Problem> {
    let mut opened = Vec::with_capacity(ids.len());
    for (at, id) in ids.iter().enumerate() {
        opened.push(emission::open(shelf, *id, &format!("/inputs/datasets/{at}")).await?);
    }
    Ok(opened)
}

/// Checks the inputs against their schema and the data sets.
pub(super) async fn accept(shelf: Shelf<'_>, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    if let Some(fault) = emission::check_seed(read.seed) {
        return Err(invalid_inputs(vec![fault]));
    }
    if !(2..=MOST_SETS).contains(&read.datasets.len()) {
        let detail = format!("must be 2 to {MOST_SETS} data sets, not {}", read.datasets.len());
        return Err(invalid_inputs(vec![FieldError::new("/inputs/datasets", "wrong_length", detail)]));
    }
    let opened = open_all(shelf, &read.datasets).await?;
    let catalogues = opened.iter().map(Opened::catalogue).collect::<Result<Vec<_>, _>>()?;
    compare::check(&catalogues.iter().collect::<Vec<_>>(), &read.options).map_err(|refused| {
        let set = format!("/inputs/datasets/{}", refused.index);
        invalid_inputs(vec![emission::field_error(&refused.error, "/inputs/options", &set)])
    })?;
    let inputs = serde_json::to_value(&read).map_err(Problem::internal)?;
    let heads: Vec<_> = opened.iter().map(|opened| &opened.head).collect();
    Ok(Accepted { hash: emission::hash(&inputs, &heads), inputs })
}

pub(super) async fn payload(shelf: Shelf<'_>, job: &Job) -> Result<Vec<u8>, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let opened = open_all(shelf, &inputs.datasets).await.map_err(emission::gone)?;
    emission::pack(job, opened)
}

/// Compares and draws.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let unpacked: Unpacked<Inputs> = emission::unpack(payload)?;
    let Unpacked { inputs, heads, catalogues, mut provenance, .. } = unpacked;
    let sets: Vec<&Catalogue> = catalogues.iter().collect();
    let found = compare::compare(&sets, &inputs.options, inputs.seed, progress).map_err(emission::failure)?;
    provenance["seed"] = json!(inputs.seed);
    let names: Vec<&str> = heads.iter().map(|head| head.name.as_str()).collect();
    let synthetic = heads.iter().any(|head| head.synthetic);
    let (artifacts, figures) = emission::drawn(&figures::of_comparison(&found, &names, synthetic), inputs.figures)?;
    let results = json!({"datasets": heads, "comparison": found, "figures": figures, "provenance": provenance});
    Ok(Output { results, artifacts, ..Output::default() })
}

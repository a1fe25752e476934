//! From a JSON Schema to words: which fields of a value are at fault and what each would accept.
//!
//! The types are the truth, since they read the value; their published schema is consulted only to explain a refusal
//! in full, so that a caller sees every mistake at once and in the words of the contract.

use std::{
    any::TypeId,
    collections::HashMap,
    sync::{Arc, LazyLock, Mutex, PoisonError},
};

use jsonschema::{ValidationError, Validator, error::ValidationErrorKind};
use serde::de::DeserializeOwned;
use serde_json::Value;
use utoipa::{PartialSchema, ToSchema};

use super::problem::FieldError;

/// The JSON Schema of `T`, without references: whatever part of it is published alone can be read alone.
#[must_use]
pub fn schema_of<T: ToSchema>() -> Value {
    let mut parts = Vec::new();
    T::schemas(&mut parts);
    let parts: Parts =
        parts.into_iter().filter_map(|(name, part)| serde_json::to_value(part).ok().map(|part| (name, part))).collect();
    let schema = serde_json::to_value(<T as PartialSchema>::schema()).unwrap_or(Value::Null);
    resolved(schema, &parts, 0)
}

/// Schemas by the names that references call them by.
type Parts = HashMap<String, Value>;

/// `schema` with its references replaced by what they name, and parts that must all hold (`allOf`) joined into one object:
/// each of them by itself would forbid the fields of the others.
fn resolved(schema: Value, parts: &Parts, depth: usize) -> Value {
    // no type of ours holds itself
    const DEEPEST: usize = 64;
    match schema {
        Value::Array(items) if depth < DEEPEST => {
            items.into_iter().map(|item| resolved(item, parts, depth + 1)).collect()
        }
        Value::Object(mut members) if depth < DEEPEST => {
            if let Some(Value::String(reference)) = members.remove("$ref") {
                let name = reference.rsplit('/').next().unwrap_or_default();
                if let Some(Value::Object(part)) = parts.get(name) {
                    // what is said beside a reference is said of this field
                    let mut whole = part.clone();
                    whole.extend(members);
                    return resolved(Value::Object(whole), parts, depth + 1);
                }
            }
            let branches = members.remove("allOf").and_then(|all| all.as_array().cloned()).unwrap_or_default();
            let mut whole: serde_json::Map<String, Value> =
                members.into_iter().map(|(name, value)| (name, resolved(value, parts, depth + 1))).collect();
            for branch in branches {
                if let Value::Object(branch) = resolved(branch, parts, depth + 1) {
                    join(&mut whole, branch);
                }
            }
            Value::Object(whole)
        }
        other => other,
    }
}

fn join(whole: &mut serde_json::Map<String, Value>, branch: serde_json::Map<String, Value>) {
    for (name, value) in branch {
        match (whole.get_mut(&name), value) {
            (Some(Value::Object(there)), Value::Object(more)) => there.extend(more),
            (Some(Value::Array(there)), Value::Array(more)) => there.extend(more),
            // the first description is that of the field itself
            (Some(_), _) => {}
            (None, value) => {
                whole.insert(name, value);
            }
        }
    }
}

struct Explainer {
    schema: Value,
    validator: Validator,
}

static EXPLAINERS: LazyLock<Mutex<HashMap<TypeId, Option<Arc<Explainer>>>>> = LazyLock::new(Mutex::default);

fn explainer<T: ToSchema + 'static>() -> Option<Arc<Explainer>> {
    let mut known = EXPLAINERS.lock().unwrap_or_else(PoisonError::into_inner);
    known
        .entry(TypeId::of::<T>())
        .or_insert_with(|| {
            let schema = schema_of::<T>();
            let validator = jsonschema::options().should_validate_formats(true).build(&schema).ok()?;
            Some(Arc::new(Explainer { schema, validator }))
        })
        .clone()
}

/// Reads `value` as `T`.
///
/// # Errors
/// Every field at fault, its pointer below `prefix`; at least one.
pub fn read<T: DeserializeOwned + ToSchema + 'static>(value: &Value, prefix: &str) -> Result<T, Vec<FieldError>> {
    serde_path_to_error::deserialize(value).map_err(|error| explain::<T>(value, &error, prefix))
}

/// Faults of one document that are named; whoever mends these learns of more.
const MOST_FAULTS: usize = 20;

/// The fields of `value` at fault by the schema of `T`; the reader's own words where the schema finds nothing.
pub fn explain<T: ToSchema + 'static>(
    value: &Value,
    error: &serde_path_to_error::Error<serde_json::Error>,
    prefix: &str,
) -> Vec<FieldError> {
    let mut faults = explainer::<T>().map_or_else(Vec::new, |explainer| {
        let errors = explainer.validator.iter_errors(value).take(MOST_FAULTS);
        errors.flat_map(|error| explainer.faults(&error, prefix)).take(MOST_FAULTS).collect()
    });
    if faults.is_empty() {
        faults.push(reader_fault(error, prefix));
    }
    faults
}

/// The reader's fault as a pointer and a sentence.
#[must_use]
pub fn reader_fault(error: &serde_path_to_error::Error<serde_json::Error>, prefix: &str) -> FieldError {
    let mut pointer = prefix.to_owned();
    for segment in error.path() {
        use serde_path_to_error::Segment;
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } | Segment::Enum { variant: key } => {
                pointer.push('/');
                pointer.push_str(&escape(key));
            }
            Segment::Unknown => {}
        }
    }
    let text = error.inner().to_string();
    // the position that serde_json adds is that of a value in memory, which tells the caller nothing
    let detail = short(text.split(" at line ").next().unwrap_or(&text).to_owned());
    FieldError::new(pointer, "invalid_value", detail)
}

/// A key as a segment of a JSON pointer (RFC 6901).
#[must_use]
pub fn escape(key: &str) -> String {
    key.replace('~', "~0").replace('/', "~1")
}

impl Explainer {
    fn faults(&self, error: &ValidationError<'_>, prefix: &str) -> Vec<FieldError> {
        let at = format!("{prefix}{}", error.instance_path());
        match error.kind() {
            ValidationErrorKind::OneOfNotValid { context } | ValidationErrorKind::AnyOf { context } => {
                self.closest_branch(context, prefix, &at, error)
            }
            ValidationErrorKind::AdditionalProperties { unexpected } => {
                let known = self.known_properties(error);
                // the list once: a body of nothing but unknown fields must not come back many times as large
                let fault = |(place, name): (usize, &String)| {
                    let detail = match place {
                        0 => format!("is not a field here; accepted: {known}"),
                        _ => "is not a field here either".to_owned(),
                    };
                    FieldError::new(format!("{at}/{}", escape(&short(name.clone()))), "unknown_field", detail)
                };
                unexpected.iter().take(MOST_FAULTS).enumerate().map(fault).collect()
            }
            ValidationErrorKind::Required { property } => {
                let name = property.as_str().unwrap_or_default();
                let detail = self.required_detail(error, name);
                vec![FieldError::new(format!("{at}/{}", escape(name)), "missing_field", detail)]
            }
            ValidationErrorKind::Enum { options } => {
                let detail = format!("must be one of {}, not {}", list(options), short(error.instance().to_string()));
                vec![FieldError::new(at, "not_in_list", detail)]
            }
            ValidationErrorKind::Minimum { .. } | ValidationErrorKind::Maximum { .. } => {
                vec![FieldError::new(at, "out_of_range", self.range_detail(error))]
            }
            kind => vec![FieldError::new(at, code(kind), short(error.to_string()))],
        }
    }

    /// Of the alternatives of a field, the one that was meant: whichever does not merely want null.
    fn closest_branch(
        &self,
        context: &[Vec<ValidationError<'static>>],
        prefix: &str,
        at: &str,
        error: &ValidationError<'_>,
    ) -> Vec<FieldError> {
        let wants_null = |branch: &&Vec<ValidationError<'static>>| {
            branch.first().is_some_and(|first| {
                matches!(first.kind(), ValidationErrorKind::Type { .. })
                    && self.at(first, 0).and_then(|schema| schema.as_str()) == Some("null")
            })
        };
        let meant: Vec<_> = context.iter().filter(|branch| !wants_null(branch)).collect();
        match meant.as_slice() {
            [branch] => branch.iter().flat_map(|error| self.faults(error, prefix)).take(MOST_FAULTS).collect(),
            _ => vec![FieldError::new(at, "no_alternative", short(error.to_string()))],
        }
    }

    /// The part of the schema that a fault comes from, `up` levels above its keyword.
    fn at(&self, error: &ValidationError<'_>, up: usize) -> Option<&Value> {
        let path = error.schema_path().to_string();
        let segments: Vec<&str> = path.split('/').skip(1).collect();
        let mut node = &self.schema;
        for segment in segments.iter().take(segments.len().saturating_sub(up)) {
            node = if let Ok(index) = segment.parse::<usize>() {
                node.get(index).or_else(|| node.get(segment))?
            } else {
                node.get(segment.replace("~1", "/").replace("~0", "~"))?
            };
        }
        Some(node)
    }

    fn known_properties(&self, error: &ValidationError<'_>) -> String {
        let properties = self.at(error, 1).and_then(|schema| schema.get("properties")).and_then(Value::as_object);
        properties.map_or_else(String::new, |map| map.keys().cloned().collect::<Vec<_>>().join(", "))
    }

    fn required_detail(&self, error: &ValidationError<'_>, name: &str) -> String {
        let about = self
            .at(error, 1)
            .and_then(|schema| schema.get("properties")?.get(name)?.get("description")?.as_str())
            .map_or_else(String::new, |about| format!(": {about}"));
        format!("is required{about}")
    }

    fn range_detail(&self, error: &ValidationError<'_>) -> String {
        let schema = self.at(error, 1);
        let bound = |name: &str| schema.and_then(|schema| schema.get(name)).map(Value::to_string);
        let range = match (bound("minimum"), bound("maximum")) {
            (Some(min), Some(max)) => format!("from {min} to {max}"),
            (Some(min), None) => format!("at least {min}"),
            (None, Some(max)) => format!("at most {max}"),
            (None, None) => return error.to_string(),
        };
        let about = schema.and_then(|schema| schema.get("description")?.as_str());
        let about = about.map_or_else(String::new, |about| format!(" ({})", about.trim_end_matches('.')));
        format!("must be {range}{about}, not {}", short(error.instance().to_string()))
    }
}

/// What a caller sent is repeated to them, but not megabytes of it.
fn short(text: String) -> String {
    const LONGEST: usize = 300;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{} ...", &text[..end]),
        None => text,
    }
}

fn list(options: &Value) -> String {
    let options = options.as_array().map_or(&[][..], Vec::as_slice);
    options.iter().map(Value::to_string).collect::<Vec<_>>().join(", ")
}

fn code(kind: &ValidationErrorKind) -> &'static str {
    match kind {
        ValidationErrorKind::Type { .. } => "wrong_type",
        ValidationErrorKind::Format { .. } => "wrong_format",
        ValidationErrorKind::Pattern { .. } => "wrong_pattern",
        ValidationErrorKind::MinLength { .. } | ValidationErrorKind::MaxLength { .. } => "wrong_length",
        _ => "invalid_value",
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::domain::{observation::DatedObservation, station::StationBody};

    fn faults<T: DeserializeOwned + ToSchema + 'static>(value: &Value) -> Vec<(String, String, String)> {
        let Err(faults) = read::<T>(value, "") else { return Vec::new() };
        faults.into_iter().map(|fault| (fault.pointer, fault.code, fault.detail)).collect()
    }

    #[test]
    fn every_mistake_of_a_body_is_told_at_once_with_what_is_accepted() {
        let body = json!({"date": "2007-02-14", "air_temperature": 300, "wind_speed": "strong", "snow": 1,
                          "avalanche_activity": "maybe"});
        let found = faults::<DatedObservation>(&body);
        let of = |pointer: &str| {
            found.iter().find(|fault| fault.0 == pointer).cloned().unwrap_or_else(|| panic!("{found:?}"))
        };
        assert_eq!(of("/air_temperature").1, "out_of_range");
        assert!(of("/air_temperature").2.contains("from -60 to 40"), "{found:?}");
        assert_eq!(of("/wind_speed").1, "wrong_type");
        assert_eq!(of("/snow").1, "unknown_field");
        assert!(of("/snow").2.contains("snow_height"));
        assert_eq!(of("/avalanche_activity").1, "not_in_list");
        assert!(of("/avalanche_activity").2.contains("\"presumed\""));
    }

    #[test]
    fn what_only_the_reader_knows_is_told_in_its_words() {
        let found = faults::<StationBody>(&json!({"name": "x", "timezone": "Europe/Atlantis"}));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].0, "/timezone");
        assert!(found[0].2.contains("Europe/London"), "{found:?}");
    }

    #[test]
    fn a_missing_field_is_named() {
        let found = faults::<StationBody>(&json!({}));
        assert_eq!((found[0].0.as_str(), found[0].1.as_str()), ("/name", "missing_field"));
    }

    #[test]
    fn a_good_body_has_no_faults() {
        assert!(
            faults::<StationBody>(&json!({"name": "x", "variables": ["air_temperature"], "latitude": null})).is_empty()
        );
    }
}

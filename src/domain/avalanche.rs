//! What is known of the avalanches of one day.
//!
//! An activity of `unknown` says that nobody could tell; it is never read as `none`.

use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use super::units::{AvalancheCount, AvalancheSize};
use crate::science::forecast::day::Activity;

/// Every activity with its name in JSON and CSV.
pub const ACTIVITIES: [(Activity, &str); 4] = [
    (Activity::Observed, "observed"),
    (Activity::Presumed, "presumed"),
    (Activity::None, "none"),
    (Activity::Unknown, "unknown"),
];

/// The name of an activity in JSON and CSV.
#[must_use]
pub const fn activity_name(activity: Activity) -> &'static str {
    match activity {
        Activity::Observed => "observed",
        Activity::Presumed => "presumed",
        Activity::None => "none",
        Activity::Unknown => "unknown",
    }
}

/// The activity of that name, `None` for any other word.
#[must_use]
pub fn activity_from_name(name: &str) -> Option<Activity> {
    ACTIVITIES.into_iter().find_map(|(activity, known)| (known == name).then_some(activity))
}

/// Stands in API documents for [`Activity`], which lives in the science and knows no schemas.
pub struct ActivitySchema;

impl PartialSchema for ActivitySchema {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .enum_values(Some(ACTIVITIES.map(|(_, name)| name)))
            .description(Some(
                "What is known of the avalanches of a day: `observed` at least one was seen; `presumed` none was seen \
                 but they were judged likely; `none` none was seen and none was judged likely; `unknown` nobody could \
                 say, which is never counted as `none`.",
            ))
            .into()
    }
}

impl ToSchema for ActivitySchema {
    fn name() -> std::borrow::Cow<'static, str> {
        "Activity".into()
    }
}

/// Writes an enumeration of words with its name in JSON, CSV and the database.
macro_rules! words {
    ($(#[$about:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $word:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum $name {
            $($(#[$doc])* $variant,)+
        }

        impl $name {
            /// Every value.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The word in JSON and CSV.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }

            /// The value of that word, `None` for any other word.
            #[must_use]
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|value| value.name() == name)
            }
        }
    };
}

words! {
    /// Wetness of the snow of the avalanches of a day.
    AvalancheType {
        /// Dry snow.
        Dry = "dry",
        /// Wet snow.
        Wet = "wet",
        /// Dry and wet avalanches, or one of both.
        Mixed = "mixed",
        /// Nobody could tell.
        Unknown = "unknown",
    }
}

words! {
    /// What set the avalanches of a day off.
    AvalancheTrigger {
        /// No person.
        Natural = "natural",
        /// A person or an explosive.
        Triggered = "triggered",
        /// Some natural, some triggered.
        NaturalAndTriggered = "natural_and_triggered",
        /// A falling cornice.
        Cornice = "cornice",
        /// Nobody could tell.
        Unknown = "unknown",
    }
}

/// What was recorded of the avalanches of one day in the region of a station.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AvalancheRecord {
    /// Whether avalanches were seen, judged likely, ruled out, or nobody could say.
    #[schema(value_type = ActivitySchema)]
    pub activity: Activity,
    /// Number of avalanches seen; null where it was not stated.
    pub count: Option<AvalancheCount>,
    /// Wetness of the snow; null where it was not stated.
    pub r#type: Option<AvalancheType>,
    /// What set them off; null where it was not stated.
    pub trigger: Option<AvalancheTrigger>,
    /// Size of the largest on the European scale of 1 to 5, in steps of 0.5; null where it was not stated.
    pub size: Option<AvalancheSize>,
}

impl AvalancheRecord {
    /// A record that states nothing but the activity.
    #[must_use]
    pub const fn of(activity: Activity) -> Self {
        Self { activity, count: None, r#type: None, trigger: None, size: None }
    }

    /// What contradicts itself in the record; empty for a record that can be true.
    #[must_use]
    pub fn contradictions(&self) -> Vec<Contradiction> {
        let mut found = Vec::new();
        let count = self.count.map(AvalancheCount::get);
        if self.activity != Activity::Observed && count.is_some_and(|count| count > 0) {
            found.push(Contradiction::CountedButNotObserved { activity: self.activity });
        }
        if self.activity == Activity::Observed && count == Some(0) {
            found.push(Contradiction::ObservedButNoneCounted);
        }
        if self.activity == Activity::None {
            let stated = [
                ("type", self.r#type.is_some_and(|stated| stated != AvalancheType::Unknown)),
                ("trigger", self.trigger.is_some_and(|stated| stated != AvalancheTrigger::Unknown)),
                ("size", self.size.is_some()),
            ];
            let described = stated.into_iter().filter_map(|(field, stated)| stated.then_some(field));
            found.extend(described.map(|field| Contradiction::NoneButDescribed { field }));
        }
        found
    }
}

/// Fields of one record that cannot be true together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Contradiction {
    /// A count above 0 on a day without an observed avalanche.
    #[error("avalanches were counted, so the activity cannot be `{}`: say `observed`, or a count of 0 or null", activity_name(*.activity))]
    CountedButNotObserved {
        /// The activity that was given.
        activity: Activity,
    },
    /// A count of 0 on a day with an observed avalanche.
    #[error("the activity is `observed`, so the count cannot be 0: give the number seen, or null")]
    ObservedButNoneCounted,
    /// Type, trigger or size of avalanches that did not happen.
    #[error("the activity is `none`, so no {field} can be stated: leave it out, or correct the activity")]
    NoneButDescribed {
        /// The field of [`AvalancheRecord`] that is stated.
        field: &'static str,
    },
    /// Count, type, trigger or size without the activity they describe.
    #[error("avalanches are described without an activity: add one of observed, presumed, none, unknown")]
    DescribedWithoutActivity,
}

impl Contradiction {
    /// The field to point at in an [`AvalancheRecord`].
    #[must_use]
    pub const fn record_field(self) -> &'static str {
        match self {
            Self::CountedButNotObserved { .. } | Self::ObservedButNoneCounted => "count",
            Self::NoneButDescribed { field } => field,
            Self::DescribedWithoutActivity => "activity",
        }
    }

    /// The field to point at in an [`Observation`](super::observation::Observation), where the names start with `avalanche_`.
    #[must_use]
    pub fn observation_field(self) -> String {
        format!("avalanche_{}", self.record_field())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_the_same_in_json_and_by_name() {
        for &word in AvalancheTrigger::ALL {
            assert_eq!(serde_json::to_value(word).unwrap(), word.name());
            assert_eq!(AvalancheTrigger::from_name(word.name()), Some(word));
        }
        for &word in AvalancheType::ALL {
            assert_eq!(serde_json::to_value(word).unwrap(), word.name());
        }
        for (activity, name) in ACTIVITIES {
            assert_eq!(serde_json::to_value(activity).unwrap(), name);
            assert_eq!((activity_from_name(name), activity_name(activity)), (Some(activity), name));
        }
    }
}

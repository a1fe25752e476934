//! The models that are always scored side by side.

use serde::{Deserialize, Serialize};

/// One thing for each model. In JSON the keys are the names of the fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PerModel<T> {
    /// The support vector machine with Platt probabilities.
    pub svm: T,
    /// Base rate by day of season.
    pub climatology: T,
    /// The label of the day before the target day.
    pub persistence: T,
    /// Share of avalanche days among the 10 nearest days by the reported variables of the base day.
    pub knn10: T,
    /// Share of avalanche days among the 30 nearest days by all features.
    pub knn30: T,
    /// Ridge-penalised logistic regression on all features.
    pub logistic: T,
}

impl<T> PerModel<T> {
    /// Applies `f` to each model's.
    pub fn map<U>(&self, mut f: impl FnMut(&T) -> U) -> PerModel<U> {
        PerModel {
            svm: f(&self.svm),
            climatology: f(&self.climatology),
            persistence: f(&self.persistence),
            knn10: f(&self.knn10),
            knn30: f(&self.knn30),
            logistic: f(&self.logistic),
        }
    }

    /// Applies `f` to each model's, up to the first failure.
    ///
    /// # Errors
    /// The first that `f` gives.
    pub fn try_map<U, E>(&self, mut f: impl FnMut(&T) -> Result<U, E>) -> Result<PerModel<U>, E> {
        Ok(PerModel {
            svm: f(&self.svm)?,
            climatology: f(&self.climatology)?,
            persistence: f(&self.persistence)?,
            knn10: f(&self.knn10)?,
            knn30: f(&self.knn30)?,
            logistic: f(&self.logistic)?,
        })
    }

    /// Applies `f` to each model's and `other`'s of the same model.
    pub fn zip_with<U, V>(&self, other: &PerModel<U>, mut f: impl FnMut(&T, &U) -> V) -> PerModel<V> {
        PerModel {
            svm: f(&self.svm, &other.svm),
            climatology: f(&self.climatology, &other.climatology),
            persistence: f(&self.persistence, &other.persistence),
            knn10: f(&self.knn10, &other.knn10),
            knn30: f(&self.knn30, &other.knn30),
            logistic: f(&self.logistic, &other.logistic),
        }
    }

    /// Name and content of each model, in the order of the fields.
    #[must_use]
    pub fn named(&self) -> [(&'static str, &T); 6] {
        [
            ("svm", &self.svm),
            ("climatology", &self.climatology),
            ("persistence", &self.persistence),
            ("knn10", &self.knn10),
            ("knn30", &self.knn30),
            ("logistic", &self.logistic),
        ]
    }
}

impl<T> PerModel<Vec<T>> {
    /// Puts `more` at the end of each model's list.
    pub(crate) fn append(&mut self, more: Self) {
        self.svm.extend(more.svm);
        self.climatology.extend(more.climatology);
        self.persistence.extend(more.persistence);
        self.knn10.extend(more.knn10);
        self.knn30.extend(more.knn30);
        self.logistic.extend(more.logistic);
    }
}

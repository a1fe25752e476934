//! Figures of results: what is drawn stands here, how it is drawn in `plot`.

mod axes;
mod comparison;
mod outcomes;
mod plot;
mod selection;

pub use comparison::of_comparison;
pub use outcomes::{of_catalogue, of_outcome};
pub use plot::{DrawError, ImageFormat, Plot};
pub use selection::of_selection;

/// A figure of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Its name, also that of its file: small letters, digits and `-`.
    pub name: String,
    /// What it shows.
    pub title: String,
    plot: Plot,
}

impl Figure {
    fn new(name: impl Into<String>, plot: Plot) -> Self {
        Self { name: name.into(), title: plot.title.clone(), plot }
    }

    /// The picture.
    ///
    /// # Errors
    /// [`DrawError`] where it cannot be drawn.
    pub fn draw(&self, format: ImageFormat) -> Result<Vec<u8>, DrawError> {
        self.plot.draw(format)
    }
}

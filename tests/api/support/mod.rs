//! Servers to ask, and answers to look at.

pub mod answer;
pub mod app;
pub mod binary;
pub mod data;
pub mod trained;

pub use answer::Answer;
pub use app::TestApp;

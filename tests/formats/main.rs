//! File formats against the real archive and against arbitrary input.

mod archive;
mod properties;

//! File formats against the real archive and against arbitrary input.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail loudly and say what they skip")]

mod archive;
mod properties;

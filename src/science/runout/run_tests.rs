//! Whole runs on a coarse mesh.

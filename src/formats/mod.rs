//! What comes in and goes out as files: pure functions from bytes to rows, without HTTP and SQL.

//! Content hashes (BLAKE3, lower-case hex): what a cell, a sequence or a file *is*.

use std::path::Path;

use serde::Serialize;

use super::error::{Error, Result};

/// Hash of bytes, 64 hex digits.
pub fn of_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Hash of a file's content.
pub fn of_file(path: &Path) -> Result<String> {
    Ok(of_bytes(&super::files::read_bytes(path)?))
}

/// Hash of a value by its JSON form (field order is the declaration's, floats are shortest round-trip).
pub fn of_value(value: &impl Serialize) -> Result<String> {
    let text = serde_json::to_vec(value).map_err(|e| Error::input(format!("cannot hash: {e}")))?;
    Ok(of_bytes(&text))
}

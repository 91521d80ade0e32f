//! A value with its source.

use std::ops::Deref;

use serde::{Deserialize, Serialize};

/// Where a value comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NumberSource {
    /// The RESPIRE paper says so.
    #[serde(rename = "paper")]
    Paper,
    /// The released code of BridgeSplat, or of the code it was built on.
    #[serde(rename = "released code")]
    ReleasedCode,
    /// Our choice, because none is published.
    #[serde(rename = "ours")]
    Ours,
}

/// A value with its source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sourced<T> {
    /// The value.
    pub value: T,
    /// Where it comes from.
    pub source: NumberSource,
    /// Place in the source, or the reason for the choice; for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub why: String,
}

impl<T> Deref for Sourced<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.value
    }
}

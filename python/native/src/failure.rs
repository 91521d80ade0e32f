//! Errors of the library as Python exceptions: the same sentence, naming file and element.

use pyo3::prelude::*;

pyo3::create_exception!(respire_bench, Error, pyo3::exceptions::PyException, "What went wrong, in one sentence.");

/// Carries an error of the library into Python.
pub trait OrRaise<T> {
    /// The value, or an [`Error`] with the library's sentence.
    fn or_raise(self) -> PyResult<T>;
}

impl<T> OrRaise<T> for respire_bench::base::Result<T> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|e| Error::new_err(e.to_string()))
    }
}

/// An [`Error`] with this sentence.
pub fn refused(sentence: impl Into<String>) -> PyErr {
    Error::new_err(sentence.into())
}

//! The native half of the Python package `respire_bench`: numpy arrays in, numpy arrays out. What a user sees, with its
//! documentation, is in `respire_bench/*.py`.
//!
//! | file | holds |
//! |---|---|
//! | `film` | a film's folder or a participant's, read file by file |
//! | `predict` | a prediction's folder |
//! | `rasterize` | the splat core behind `rasterize` |
//! | `threads` | the interpreter's thread as one of those that render |
//! | `failure` | errors of the library as Python exceptions |

mod failure;
mod film;
mod predict;
mod rasterize;
mod threads;

use pyo3::prelude::*;

/// The module `respire_bench._native`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<failure::Error>())?;
    module.add_class::<film::Film>()?;
    module.add_class::<rasterize::Pass>()?;
    module.add_class::<predict::PredictionFolder>()?;
    module.add_function(wrap_pyfunction!(rasterize::forward, module)?)?;
    module.add_function(wrap_pyfunction!(rasterize::time_core, module)?)
}

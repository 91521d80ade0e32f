//! The module `respire_bench._native` that Python loads; what is in it: `native/src/lib.rs`.

use pyo3::prelude::*;
use respire_bench_native::{failure, film, predict, rasterize};

/// The module `respire_bench._native`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<failure::Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<film::Film>()?;
    module.add_class::<rasterize::Pass>()?;
    module.add_class::<predict::PredictionFolder>()?;
    module.add_function(wrap_pyfunction!(rasterize::forward, module)?)?;
    module.add_function(wrap_pyfunction!(rasterize::time_core, module)?)
}

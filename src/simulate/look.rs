//! The wall that a case asks for.

use crate::airway::case::Case;
use crate::base::{Error, Result};
use crate::render::Material;

/// The look that the case file asks for. Errors: a key or value that no material has.
pub fn material(case: &Case) -> Result<Material> {
    let material: Material = case
        .material
        .clone()
        .try_into()
        .map_err(|e| Error::input(e.to_string().trim_end().replace('\n', " ")).element("material"))?;
    let material = material.as_given(&case.material)?;
    material.validate()?;
    Ok(material)
}

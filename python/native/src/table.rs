//! Gradients as Python holds them: tables of the core whose memory comes back when the last array over it is gone. New
//! memory would cost each pass the zeros that it begins with, and the cache that holds the last pass's.

use std::sync::PoisonError;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use respire_bench::splat::{Gradients, Wanted};

use crate::rasterize::Float;

/// Tables of each kind that are kept for later passes.
const KEPT: usize = 6;
/// A kept table serves a pass that needs at least this share of it.
const LEAST_USED: f64 = 0.5;

/// Numbers of Gaussians, by how many belong together.
pub enum TableOf<T> {
    One(Vec<T>),
    Three(Vec<[T; 3]>),
    Four(Vec<[T; 4]>),
}

impl<T> TableOf<T> {
    /// All numbers.
    pub fn values(&self) -> &[T] {
        match self {
            TableOf::One(table) => table,
            TableOf::Three(table) => table.as_flattened(),
            TableOf::Four(table) => table.as_flattened(),
        }
    }

    /// The address of the first number, for others to write to.
    fn address(&mut self) -> usize {
        match self {
            TableOf::One(table) => table.as_mut_ptr() as usize,
            TableOf::Three(table) => table.as_mut_ptr() as usize,
            TableOf::Four(table) => table.as_mut_ptr() as usize,
        }
    }
}

/// Tables that nobody needs any more.
pub struct Pool<T> {
    ones: Vec<Vec<T>>,
    threes: Vec<Vec<[T; 3]>>,
    fours: Vec<Vec<[T; 4]>>,
}

/// Takes the kept table that is nearest to `length`; an empty one where none fits.
fn nearest<V>(kept: &mut Vec<Vec<V>>, length: usize) -> Vec<V> {
    let fits = |table: &Vec<V>| table.len() >= length && length as f64 >= LEAST_USED * table.capacity() as f64;
    let best = (0..kept.len()).filter(|&k| length > 0 && fits(&kept[k])).min_by_key(|&k| kept[k].len());
    best.map_or_else(Vec::new, |k| kept.swap_remove(k))
}

/// Keeps a table; the one that has waited longest goes.
fn keep<V>(kept: &mut Vec<Vec<V>>, table: Vec<V>) {
    if kept.len() == KEPT {
        kept.remove(0);
    }
    kept.push(table);
}

impl<T: Float> Pool<T> {
    /// Nothing is kept yet.
    pub const fn new() -> Self {
        Pool { ones: Vec::new(), threes: Vec::new(), fours: Vec::new() }
    }

    /// Tables for the `wanted` gradients of `n` Gaussians with `sh` coefficients in all.
    pub fn take(&mut self, n: usize, sh: usize, wanted: Wanted) -> Gradients<T> {
        let of = |group: Wanted, length: usize| if wanted.any(group) { length } else { 0 };
        Gradients {
            positions: nearest(&mut self.threes, of(Wanted::POSITIONS, n)),
            rotations: nearest(&mut self.fours, of(Wanted::SHAPES, n)),
            scales: nearest(&mut self.threes, of(Wanted::SHAPES, n)),
            opacities: nearest(&mut self.ones, of(Wanted::OPACITIES, n)),
            sh: nearest(&mut self.ones, of(Wanted::SH, sh)),
            ..Gradients::default()
        }
    }

    /// Keeps a table.
    pub fn give(&mut self, table: TableOf<T>) {
        match table {
            TableOf::One(table) => keep(&mut self.ones, table),
            TableOf::Three(table) => keep(&mut self.threes, table),
            TableOf::Four(table) => keep(&mut self.fours, table),
        }
    }
}

/// A table of either number type.
pub enum Memory {
    Single(TableOf<f32>),
    Double(TableOf<f64>),
}

/// What numpy's array over a table holds on to.
#[pyclass(frozen)]
pub struct Table {
    /// Taken only when the last array over it is gone; until then the numbers belong to Python.
    memory: Option<Memory>,
    address: usize,
    length: usize,
}

impl Table {
    /// For Python.
    pub fn new(mut memory: Memory) -> Table {
        let (address, length) = match &mut memory {
            Memory::Single(table) => (table.address(), table.values().len()),
            Memory::Double(table) => (table.address(), table.values().len()),
        };
        Table { memory: Some(memory), address, length }
    }
}

#[pymethods]
impl Table {
    /// numpy's array interface, version 3.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let kind = if matches!(self.memory, Some(Memory::Single(_))) { "<f4" } else { "<f8" };
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("typestr", kind)?;
        interface.set_item("shape", (self.length,))?;
        interface.set_item("data", (self.address, false))?;
        Ok(interface)
    }
}

impl Drop for Table {
    fn drop(&mut self) {
        match self.memory.take() {
            Some(Memory::Single(table)) => f32::pool().lock().unwrap_or_else(PoisonError::into_inner).give(table),
            Some(Memory::Double(table)) => f64::pool().lock().unwrap_or_else(PoisonError::into_inner).give(table),
            None => {}
        }
    }
}

//! Numbers between Python and Rust.

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyException;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyFloat;

use crate::errors::input;

/// Numbers with their shape, in C order.
#[derive(Debug, Default)]
pub(crate) struct Numbers {
    /// The extents; none of a single number.
    pub(crate) shape: Vec<usize>,
    /// The numbers.
    pub(crate) data: Vec<f64>,
}

impl Numbers {
    /// Reads a number, an array, or whatever numpy makes an array of numbers of. `name` stands in errors.
    pub(crate) fn of(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        // Checks of types only: a conversion that fails would cost more than a plan.
        if let Ok(array) = value.cast::<PyArrayDyn<f64>>() {
            return Ok(Self::copied(array));
        }
        if let Ok(number) = value.cast::<PyFloat>() {
            return Ok(Self { shape: Vec::new(), data: vec![number.value()] });
        }
        static ASARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
        let py = value.py();
        let made = || {
            let asarray = ASARRAY.import(py, "numpy", "asarray")?;
            let array = asarray.call1((value, intern!(py, "float64")))?;
            Ok::<_, PyErr>(Self::copied(array.cast::<PyArrayDyn<f64>>()?))
        };
        made().map_err(|error| {
            // An interrupt may come meanwhile.
            if !error.is_instance_of::<PyException>(py) {
                return error;
            }
            input(format!("{name} is not an array of numbers: {}", error.value(py)))
        })
    }

    fn copied(array: &Bound<'_, PyArrayDyn<f64>>) -> Self {
        // The memory of an array in Fortran's order is contiguous too.
        let in_c_order = || array.to_owned_array().iter().copied().collect();
        let data = if array.is_c_contiguous() { array.to_vec().unwrap_or_else(|_| in_c_order()) } else { in_c_order() };
        Self { shape: array.shape().to_vec(), data }
    }

    /// Refuses any other shape.
    pub(crate) fn shaped(self, name: &str, shape: &[usize]) -> PyResult<Vec<f64>> {
        if self.shape == shape {
            return Ok(self.data);
        }
        Err(input(format!("{name} has the shape {:?}: expected {shape:?}", self.shape)))
    }

    /// One number for each of `count`, from one for all or one for each.
    pub(crate) fn for_each(self, name: &str, count: usize) -> PyResult<Vec<f64>> {
        match (self.shape.as_slice(), self.data.first()) {
            ([], Some(number)) => Ok(vec![*number; count]),
            _ => self.shaped(name, &[count]),
        }
    }
}

/// One number for each of `count` from an argument that may be missing.
pub(crate) fn each(value: Option<&Bound<'_, PyAny>>, name: &str, count: usize) -> PyResult<Option<Vec<f64>>> {
    value.map(|value| Numbers::of(value, name)?.for_each(name, count)).transpose()
}

/// A numpy array of this shape; the number of elements must be the shape's.
pub(crate) fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    data: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    PyArray1::from_vec(py, data).reshape(shape)
}

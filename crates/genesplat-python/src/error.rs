//! Errors as exceptions, with the command's sentences.

use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

create_exception!(
    genesplat,
    Error,
    PyException,
    "What went wrong, in one sentence: what, where, what to do."
);

/// What went wrong.
pub(crate) fn told(error: impl Display) -> PyErr {
    Error::new_err(error.to_string())
}

/// An argument cannot be what it is.
pub(crate) fn wrong(problem: impl Display) -> PyErr {
    PyValueError::new_err(problem.to_string())
}

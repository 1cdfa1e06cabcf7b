"""The files of clrelight: HDF5, written whole or not at all, and read with suspicion."""

from clrelight.durable import check_output
from clrelight.store.encodings import FitRecord, read_encoded, write_encoded
from clrelight.store.fits import FitSink, create_fit, open_fit, read_fit, write_fit
from clrelight.store.fitted import open_fitted
from clrelight.store.lights import read_light, write_light
from clrelight.store.shrms import read_shrm, write_shrm
from clrelight.store.stacks import create_stack, open_stack, read_stack, write_stack
from clrelight.store.stored import StoredArray
from clrelight.store.summary import describe, file_schema
from clrelight.store.tables import read_results, write_results
from clrelight.store.writing import Sink

__all__ = [
    "FitRecord",
    "FitSink",
    "Sink",
    "StoredArray",
    "check_output",
    "create_fit",
    "create_stack",
    "describe",
    "file_schema",
    "open_fit",
    "open_fitted",
    "open_stack",
    "read_encoded",
    "read_fit",
    "read_light",
    "read_results",
    "read_shrm",
    "read_stack",
    "write_encoded",
    "write_fit",
    "write_light",
    "write_results",
    "write_shrm",
    "write_stack",
]

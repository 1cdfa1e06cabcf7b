"""Fits and encodings alike, opened once, and read as far as they are needed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from clrelight.codec.encoded import Encoded
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import StoreFormatError
from clrelight.store.encodings import encoded_of, parts_of, whole_of
from clrelight.store.fits import fit_of
from clrelight.store.opening import Opened, opening, refusing
from clrelight.store.schemas import ENCODED, FIT
from clrelight.store.scratch import ScratchWorkspace
from clrelight.store.shards import opening_fit


@dataclass(frozen=True)
class OpenFitted:
    """An open file of one of the two kinds.

    Attributes
    ----------
    notes : tuple of str
        What is to be said of it.
    """

    _opened: Opened
    notes: tuple[str, ...] = ()

    @property
    def is_encoded(self) -> bool:
        """Whether it is an encoding."""
        return self._opened.schema.kind == ENCODED.kind

    @property
    def traffic(self) -> Callable[[], dict[str, int]]:
        """What says how much was fetched."""
        return self._opened.place.traffic

    def fit(self) -> CoefficientMap:
        """Return the fit, whose arrays are read as they are indexed; StoreFormatError if it is not sound."""
        with refusing(self._opened.path):
            return fit_of(self._opened, self._opened.arrays.get)

    def whole(self, workspace: ScratchWorkspace | None = None) -> tuple[Encoded, FitRecord]:
        """Return the encoding and its record; where the payload is large for a workspace, in a file of that."""
        with refusing(self._opened.path):
            return whole_of(self._opened, workspace)

    def parts(self, *, compared: bool = True) -> tuple[Encoded, FitRecord]:
        """Return the same of a payload that is read as it is sliced, and not summed up; `compared` as of `parts_of`."""
        with refusing(self._opened.path):
            return encoded_of(self._opened, *parts_of(self._opened, compared=compared), summed=False)


@contextmanager
def open_fitted(path: str | os.PathLike, *kinds: str, salvage: bool = False) -> Iterator[OpenFitted]:
    """Open a fit or an encoding, here or behind a URL.

    Parameters
    ----------
    path : path
    *kinds : str
        ``"fit"``, ``"encoded"``; by default either.
    salvage : bool
        Open an encoding whose seal does not fit too, without it: HDF5's checksums of attributes and shapes must.

    Raises
    ------
    InputError
        If there is no such file.
    StoreFormatError
        If it is neither, or not sound.
    """
    wanted = kinds or (FIT.kind, ENCODED.kind)
    notes: tuple[str, ...] = ()
    with ExitStack() as stack:
        try:
            opened = stack.enter_context(opening_fit(path, *wanted))
        except StoreFormatError as error:
            if not salvage:
                raise
            opened = stack.enter_context(opening(path, ENCODED.kind, trusting=True))
            notes = (f"{str(error).partition(', so it is damaged')[0]}: it is read without them",)
        yield OpenFitted(opened, notes)

"""Bases of functions of the light's direction beside spherical harmonics. Importing this package registers them all."""

from clrelight.bases import entries  # noqa: F401
from clrelight.bases.carrying import OfBasis
from clrelight.bases.products import gram_matrix, harmonics_seen
from clrelight.bases.registry import SH, Basis, basis_ids, basis_of, require_sh

__all__ = ["SH", "Basis", "OfBasis", "basis_ids", "basis_of", "gram_matrix", "harmonics_seen", "require_sh"]

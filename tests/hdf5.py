"""HDF5 files as other programs change them."""

from clrelight.store.seal import SEAL_ATTRIBUTE


def unseal(file):
    """Take away the checksums of a file of ours, as the refusal of a changed one says to."""
    if SEAL_ATTRIBUTE in file.attrs:
        del file.attrs[SEAL_ATTRIBUTE], file["clrelight"]

"""clrelight: fit, compress, relight and measure image stacks of one view under many lights."""

__version__ = "0.1.0"

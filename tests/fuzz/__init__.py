"""Compiled decoders under libFuzzer: see `tests.fuzz.__main__`."""

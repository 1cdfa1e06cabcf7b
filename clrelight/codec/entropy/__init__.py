"""Indices to bits and back: symbols, contexts, the range coder."""

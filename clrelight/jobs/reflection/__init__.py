"""Verbs of reflection maps."""

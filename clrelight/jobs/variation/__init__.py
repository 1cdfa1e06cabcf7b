"""Verbs of what light does to one view."""

"""Scenes that are rendered: never hand-made numbers."""

"""Seconds and bytes: timing in turns with peers, and how the whole job grows."""

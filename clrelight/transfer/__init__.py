"""Precomputed radiance transfer: what light reaches a surface, and what it sends on."""

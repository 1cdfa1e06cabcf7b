"""Reflectances in angles from a central direction (frequency-space-environment-maps, 3.1), and their coefficients."""

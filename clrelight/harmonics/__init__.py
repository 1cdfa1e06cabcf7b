"""The mathematics of spherical harmonics: NumPy and SciPy alone, nothing of devices, files or images."""

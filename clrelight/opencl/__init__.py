"""OpenCL drivers, whether they can be trusted, and what is kept of their work between runs."""

"""Spherical harmonic reflection maps (Ramamoorthi and Hanrahan 2002): what surfaces reflect under distant light."""

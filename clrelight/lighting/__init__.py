"""Light from everywhere: environment maps, their spherical harmonics, irradiance, and relighting under them."""

from clrelight.lighting.light import Light

__all__ = ["Light"]

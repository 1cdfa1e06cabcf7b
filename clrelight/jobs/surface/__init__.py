"""Verbs of surfaces: transfer, operators, what they reflect, pictures of meshes."""

"""What light does to the pictures of one view: normals from photographs, subspaces, and the light behind an image."""

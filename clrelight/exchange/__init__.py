"""Files of other programs for relightable pictures: written from fits, and read as photographs."""

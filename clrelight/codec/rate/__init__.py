"""How many bits go where: the step search, the allocation to maps, and the noise that follows."""

"""Particles in cells: the stages put in order, the mesh that follows the particles, output, restart, limits of the machine."""

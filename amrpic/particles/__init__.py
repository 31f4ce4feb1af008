"""Macroparticles: their arrays, species and clouds, and the distributions that they are drawn from."""

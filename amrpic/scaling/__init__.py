"""How steps of a scene scale with ranks, measured on those there are."""

"""Figures of AMReX 24.10's multigrid (MLMG), as a column to stand beside: it is not installed here.

Measured on two cores with AVX-512, in work units of that run; zero guess to 1e-10 in the max norm, boxes of at most so many
cells along an axis, one rank. Scaled by the present work unit they are what it would take here, as far as both are bound by
memory.
"""

from __future__ import annotations

MLMG: dict[tuple[str, int], float] = {  # work units, by case and boxes
    ("static 64", 24): 592,
    ("static 64", 64): 420,
    ("static 128", 24): 730,
    ("static 128", 64): 581,
    ("bunch 64", 24): 570,
    ("bunch 64", 64): 529,
    ("bunch 128", 24): 718,
    ("bunch 128", 64): 570,
    ("uniform 128", 64): 555,  # 1.00 s, in the mean unit per cell of the static cases
}
MLMG_CYCLES = 8
PARTICLES = {  # ns per particle at 1e7 particles on 128³ cells in boxes of 32, AMReX; cloud-in-cell
    "deposit": 13.0,
    "gather": 17.0,
    "migrate": 39.0,
}

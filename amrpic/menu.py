"""The solver's menu: the names of its choices, and which of them do not go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from .units import complaint

Norm = Literal["max", "l1", "l2"]
Backend = Literal["matrix-free", "crs"]
Kernels = Literal["tuned", "portable"]
Smoother = Literal["red-black", "jacobi", "gauss-seidel", "symmetric-gauss-seidel", "chebyshev"]
Prolongation = Literal["trilinear", "constant"]
Bottom = Literal["gmres", "cg", "bicgstab", "multigrid", "direct"]
BottomPreconditioner = Literal[
    "none",
    "jacobi",
    "gauss-seidel",
    "ilu",
    "smoothed-aggregation",
    "plain-aggregation",
    "brick-aggregation",
    "structured-aggregation",
]
Krylov = Literal["none", "fgmres", "bicgstab"]

# Over-relaxation pays for red-black order, on refined levels most. 6/7 is what damps the oscillations of a 7-point
# Laplacian best; the library's orders are best left as they are.
RELAXATION = {"red-black": 1.28, "jacobi": 6 / 7, "gauss-seidel": 1.0, "symmetric-gauss-seidel": 1.0, "chebyshev": 1.0}


LARGEST_STRETCH = 1e9  # far beyond the Lorentz factor of any bunch


class Refusal(NamedTuple):
    """Why an option does not go with the others."""

    option: str
    found: object
    what: str
    remedy: str


def refusal(
    smoother: str,
    relaxation: float | None,
    sweeps: Sequence[int],
    bottom: str,
    bottom_preconditioner: str | None,
) -> Refusal | None:
    """Return why these choices do not go together, or None."""
    if relaxation is not None and smoother == "chebyshev":
        return Refusal(
            "relaxation", relaxation, "has no meaning for chebyshev, whose polynomial has no factor", "leave it out"
        )
    if relaxation is not None and smoother == "jacobi" and relaxation > 1:
        return Refusal("relaxation", relaxation, "makes jacobi diverge", "give a number up to 1, best about 0.86")
    if min(sweeps) < 0 or sum(sweeps) == 0:
        return Refusal(
            "sweeps",
            tuple(sweeps),
            "leaves nothing to smooth with",
            "give two numbers, before and after, at least one of them positive",
        )
    aggregates = bottom_preconditioner is None or bottom_preconditioner.endswith("aggregation")
    if bottom == "direct" and bottom_preconditioner is not None:
        return Refusal(
            "bottom_preconditioner",
            bottom_preconditioner,
            "has nothing to do in a direct solve",
            'leave it out, or set bottom to "gmres"',
        )
    if bottom == "multigrid" and not aggregates:
        return Refusal(
            "bottom_preconditioner",
            bottom_preconditioner,
            "is no multigrid, which is to stand alone",
            "use smoothed-aggregation, plain-aggregation or brick-aggregation",
        )
    return None


# What the matrix-free backend has one of, and which.
MATRIX_FREE = {
    "smoother": "red-black",
    "prolongation": "trilinear",
    "coarse_levels": None,
    "bottom": "gmres",
    "bottom_preconditioner": None,
    "krylov": "none",
}


def backend_refusal(backend: str, choices: Mapping[str, object]) -> Refusal | None:
    """Return which of the choices the backend does not offer, or None."""
    if backend == "crs":
        return None
    for option, only in MATRIX_FREE.items():
        if choices[option] != only:
            what = "is a choice of the backend of compressed rows alone"
            return Refusal(option, choices[option], what, 'leave it out, or set backend to "crs"')
    return None


def both(sweeps: int | Sequence[int]) -> Sequence[int]:
    """Return the sweeps before and after: one number stands for both."""
    return (sweeps, sweeps) if isinstance(sweeps, int) else sweeps


def stopping_refusal(tolerance: float | str, krylov: str) -> Refusal | None:
    """Return why this tolerance does not go with this acceleration, or None."""
    if tolerance != "discretization" or krylov == "none":
        return None
    what = 'does not tell how much error is left, as tolerance "discretization" must know'
    return Refusal("krylov", krylov, what, 'use "none", or a number as tolerance')


def tolerance(value: Any) -> float | str:
    """The tolerance of a solve as it is, if it is one; a complaint otherwise."""
    if value == "discretization":
        return "discretization"
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1:
        raise complaint("is no tolerance", 'give a number between 0 and 1, or "discretization"')
    return float(value)

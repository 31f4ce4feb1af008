"""The solver's menu: the names of its choices, and which of them do not go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BeforeValidator, Field, model_validator

from .complaints import complaint
from .section import Section

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


def _tolerance(value: Any) -> float | str:
    """The tolerance of a solve as it is, if it is one; a complaint otherwise."""
    if value == "discretization":
        return "discretization"
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1:
        raise complaint("is no tolerance", 'give a number between 0 and 1, or "discretization"')
    return float(value)


class Solver(Section):
    """How Poisson's equation is solved."""

    tolerance: Annotated[
        float | Literal["discretization"],
        BeforeValidator(
            _tolerance, json_schema_input_type=Annotated[float, Field(gt=0, lt=1)] | Literal["discretization"]
        ),
    ] = Field(
        default=1e-10,
        description="Residual relative to that of a zero potential at which the solve has converged; or discretization: stop "
        "where the error left in φ is a tenth of the estimated error of the mesh, which takes half the cycles or less.",
    )
    absolute_tolerance: float = Field(
        default=0.0,
        ge=0,
        description="Residual at which the solve has converged as well, in V/m² (in V m for norm l1, V/m^0.5 for l2): for "
        "scenes whose charge all but vanishes.",
    )
    norm: Norm = Field(
        default="max",
        description="Norm of the residual over uncovered cells, l1 and l2 weighted by volume; max sees every cell alike.",
    )
    backend: Backend = Field(
        default="matrix-free",
        description="How the stencils are executed. matrix-free: loops over the rows of boxes, by far the fastest and "
        "smallest. crs: compressed rows (Tpetra's matrices), with the whole menu of smoothers, prolongation, coarse_levels, "
        "bottoms and krylov, which matrix-free does not have.",
    )
    smoother: Smoother = Field(
        default="red-black",
        description="What damps the errors of a level. red-black (over-relaxed Gauss-Seidel) is the fastest measured, and the "
        "same on any number of ranks; the others are Ifpack2's, of which the Gauss-Seidel ones relax each rank's cells "
        "by themselves.",
    )
    relaxation: float | None = Field(
        default=None,
        gt=0,
        lt=2,
        description="Factor of a relaxation step; by default 1.28 for red-black, 6/7 for jacobi and 1 for Gauss-Seidel. "
        "Red-black takes it on refined levels of cubes; from the base down it takes 0.7, and where cells are long or flat "
        "0.55, of what lies beyond 1. Refused for chebyshev, which has none.",
    )
    sweeps: Annotated[tuple[int, int], BeforeValidator(both, json_schema_input_type=int | tuple[int, int])] = Field(
        default=(2, 2),
        description="Smoothing sweeps before, and after, the coarse correction: one number for both, or two. For chebyshev "
        "the degree of its polynomial.",
    )
    prolongation: Prolongation = Field(
        default="trilinear", description="Interpolation of coarse corrections; trilinear saves cycles."
    )
    stretch: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0),
        description="Factors s on the lengths: the equation is Σ s⁻² ∂²φ/∂x² = −ρ/ε₀ and E = −s⁻² ∂φ/∂x. "
        "(1, 1, γ) gives φ and E, seen at rest, of a bunch that moves along z with the Lorentz factor γ.",
    )
    coarse_levels: int | None = Field(
        default=None,
        ge=0,
        description="Multigrid levels below the base; as many as its numbers of cells have factors of two if not given, "
        "which is the fastest. 0 leaves the whole base to the bottom solver.",
    )
    bottom: Bottom = Field(
        default="gmres",
        description="What solves the coarsest level, which each rank holds whole: Krylov iterations (Belos), MueLu's "
        "multigrid alone, or direct (KLU2, up to 10 000 cells). gmres works for all; cg is refused unless the matrix is "
        "symmetric.",
    )
    bottom_preconditioner: BottomPreconditioner | None = Field(
        default=None,
        description="What helps the iterations of the bottom: a point method (Ifpack2), or multigrid by smoothed, plain, "
        "brick or structured aggregation (MueLu). smoothed-aggregation if not given; refused for direct.",
    )
    krylov: Krylov = Field(
        default="none",
        description="Krylov acceleration over all levels, with the cycle as its preconditioner: flexible GMRES or BiCGStab. "
        "Without it is faster wherever the cycle converges well.",
    )
    max_cycles: int = Field(default=50, ge=1, description="Cycles after which a solve is given up as unconverged.")
    reuse: bool = Field(
        default=True,
        description="Keep the operators of levels that a regrid leaves alone, the set-up of the bottom, and the tables of open "
        "walls.",
    )

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        wrong = refusal(self.smoother, self.relaxation, self.sweeps, self.bottom, self.bottom_preconditioner)
        wrong = wrong or stopping_refusal(self.tolerance, self.krylov)
        wrong = wrong or backend_refusal(self.backend, {name: getattr(self, name) for name in MATRIX_FREE})
        if wrong:
            raise complaint(wrong.what, wrong.remedy, path=wrong.option, found=wrong.found)
        return self

    @model_validator(mode="after")
    def _positive_stretch(self) -> Self:
        for axis, factor in enumerate(self.stretch):
            if not 0 < factor < LARGEST_STRETCH:
                remedy = f"give a factor above 0, below {LARGEST_STRETCH:g}"
                raise complaint("is no stretch", remedy, path=f"stretch.{axis}", found=factor)
        return self

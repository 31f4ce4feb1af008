"""The options of the Poisson solver: one model for the scene's section [solver], `PoissonSolver` and the native side.

An option is added here, with its default, description and checks, and under the same name in native/solver/options.hpp and
its binding. `native_values` says where the two differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from ..mesh.domain import Domain
from .complaints import complaint
from .section import Section

Norm = Literal["max", "l1", "l2"]
Backend = Literal["matrix-free", "kokkos", "crs"]
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
LARGEST_SCREENING = 1e100  # 1/m, whose square is a number still
SMALLEST = 1e-12  # tolerance that ends a solve to the discretization error, where the mesh makes none
MOST_LEVELS = 100  # multigrid levels below the base: more than any number of cells allows

# Of these the backends without compressed rows have the default alone.
OF_COMPRESSED_ROWS = ("smoother", "prolongation", "coarse_levels", "bottom", "bottom_preconditioner", "krylov")


def _both(sweeps: int | Sequence[int] | None) -> Sequence[int] | None:
    """Return the sweeps before and after: one number stands for both, none for the default."""
    if sweeps is None:
        return None
    pair = (sweeps, sweeps) if isinstance(sweeps, int) else sweeps
    if not isinstance(pair, Sequence) or len(pair) != 2:
        raise complaint("is neither one number nor two", "give one number, or two, before and after")
    return pair


def _tolerance(value: Any) -> float | str:
    """Return the tolerance of a solve as it is; a complaint if it is none."""
    if value == "discretization":
        return "discretization"
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < 1:
        raise complaint("is no tolerance", 'give a number between 0 and 1, or "discretization"')
    return float(value)


class SolverOptions(Section):
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
        description="Norm of the residual over uncovered cells, l1 and l2 weighted by volume; max treats every cell equally.",
    )
    backend: Backend = Field(
        default="matrix-free",
        description="How the stencils are executed. matrix-free: loops over the rows of boxes, by far the fastest and "
        "smallest on processors. kokkos: the same with kernels over all rows of a level, for whatever Kokkos was built for, "
        "and particles too. "
        "crs: compressed rows (Tpetra's matrices), with the whole menu of smoothers, prolongation, coarse_levels, "
        "bottoms and krylov, which the others do not have.",
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
        "Red-black takes it on refined levels of cubes; from the base down it takes 0.7, and where cells are long 0.55, of "
        "the part above 1, and where they are flat -0.3. Refused for chebyshev, which has none.",
    )
    sweeps: Annotated[
        tuple[int, int] | None, BeforeValidator(_both, json_schema_input_type=int | tuple[int, int] | None)
    ] = Field(
        default=None,
        description="Smoothing sweeps before, and after, the coarse correction: one number for both, or two; by default two of "
        "each, and in order 4 two before and one after. For chebyshev the degree of its polynomial.",
    )
    prolongation: Prolongation = Field(
        default="trilinear", description="Interpolation of coarse corrections; trilinear saves cycles."
    )
    stretch: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0),
        description="Factors s on the lengths: the equation is Σ s⁻² ∂²φ/∂x² = −ρ/ε₀ and E = −s⁻² ∂φ/∂x. "
        "(1, 1, γ) gives φ and E in the laboratory frame of a bunch that moves along z with the Lorentz factor γ.",
    )
    screening: float = Field(
        default=0.0,
        ge=0,
        lt=LARGEST_SCREENING,
        description="κ of a screened potential, −Δφ + κ²φ = ρ/ε₀, in 1/m: one over the screening length. Refused where a face "
        "of the domain is open.",
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
    order: Literal[2, 4] = Field(
        default=2,
        description="Order of accuracy. 4: finite volumes on means of cells, for densities that are smooth on the mesh, where "
        "errors are a hundred times smaller; matrix-free alone. A density that jumps, and clouds of particles, gain "
        "next to nothing.",
    )
    max_cycles: int = Field(default=100, ge=1, description="Cycles after which a solve is given up as unconverged.")

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        if self.relaxation is not None and self.smoother == "chebyshev":
            self.refuse("relaxation", "has no meaning for chebyshev, whose polynomial has no factor", "leave it out")
        if self.relaxation is not None and self.smoother == "jacobi" and self.relaxation > 1:
            self.refuse("relaxation", "makes jacobi diverge", "give a number up to 1, best about 0.86")
        if min(self.both_sweeps) < 0 or sum(self.both_sweeps) == 0:
            remedy = "give two numbers, before and after, at least one of them positive"
            self.refuse("sweeps", "leaves nothing to smooth with", remedy)
        if self.bottom == "direct" and self.bottom_preconditioner is not None:
            remedy = 'leave it out, or set bottom to "gmres"'
            self.refuse("bottom_preconditioner", "has nothing to do in a direct solve", remedy)
        aggregates = self.bottom_preconditioner is None or self.bottom_preconditioner.endswith("aggregation")
        if self.bottom == "multigrid" and not aggregates:
            remedy = "use smoothed-aggregation, plain-aggregation or brick-aggregation"
            self.refuse("bottom_preconditioner", "is no multigrid, which is to stand alone", remedy)
        if self.tolerance == "discretization" and self.krylov != "none":
            reason = 'does not know how much error is left, as tolerance "discretization" must know'
            self.refuse("krylov", reason, 'use "none", or a number as tolerance')
        for option in OF_COMPRESSED_ROWS if self.backend != "crs" else ():
            if getattr(self, option) != type(self).model_fields[option].default:
                reason = "is a choice of the backend of compressed rows alone"
                self.refuse(option, reason, 'leave it out, or set backend to "crs"')
        if self.order == 4 and self.backend != "matrix-free":
            self.refuse(
                "order", "is what the matrix-free backend has alone", 'set backend to "matrix-free", or order to 2'
            )
        for axis, factor in enumerate(self.stretch):
            if not 0 < factor < LARGEST_STRETCH:
                remedy = f"give a factor above 0, below {LARGEST_STRETCH:g}"
                self.refuse(f"stretch.{axis}", "is no stretch", remedy)
        return self

    @property
    def both_sweeps(self) -> tuple[int, int]:
        """The sweeps before and after the coarse correction. In order 4 the difference between the residual and the 7-point
        cycle leaves more of an error than a second sweep would take."""
        if self.sweeps is None:
            return (2, 1) if self.order == 4 else (2, 2)
        return self.sweeps

    @property
    def potential_holds(self) -> Literal["points", "means"]:
        """What the values of a potential are, see `Field.holds`."""
        return "means" if self.order == 4 else "points"

    def screening_refusal(self, domain: Domain) -> tuple[str, str] | None:
        """Return why a domain does not let the potential be screened, and what to do; None if it does."""
        if self.screening > 0 and any("open" in faces for faces in domain.boundary):
            return (
                "screens a potential behind open faces, whose values are those of an unscreened one",
                "close all faces (dirichlet, neumann or periodic), or leave screening out",
            )
        return None

    def native_values(self) -> dict[str, Any]:
        """Return the options by their names in the native struct; those that it has its own default for are left out."""
        values = {name: getattr(self, name) for name in SolverOptions.model_fields}
        del values["sweeps"]
        values["pre_sweeps"], values["post_sweeps"] = self.both_sweeps
        values["to_discretisation"] = self.tolerance == "discretization"
        if self.tolerance == "discretization":
            values["tolerance"] = SMALLEST
        if self.relaxation is None:
            values["relaxation"] = RELAXATION[self.smoother]
        if self.coarse_levels is not None:
            values["coarse_levels"] = min(self.coarse_levels, MOST_LEVELS)
        return {name: value for name, value in values.items() if value is not None}


class SolverSection(SolverOptions):
    """How Poisson's equation is solved."""

    reuse: bool = Field(
        default=True,
        description="Keep the operators of levels that a regrid leaves alone, the set-up of the bottom, and the tables of open "
        "walls.",
    )

    @field_validator("tolerance")
    @classmethod
    def _positive(cls, value: float | str) -> float | str:
        if value == 0:  # a run would spend most of its cycles on rounding errors
            raise complaint("is no tolerance", 'give a number between 0 and 1, or "discretization"')
        return value

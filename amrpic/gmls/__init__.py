"""Generalized moving least squares: stencils from samples on points of any arrangement. See docs/gmls.md."""

from .functionals import Basis, Functional
from .neighbours import Neighbours, nearby
from .samples import (
    Along,
    Components,
    Custom,
    Differences,
    Integrals,
    Means,
    Points,
    Samples,
    Vectors,
    WithLaplacian,
)
from .shapes import Shapes, box_faces, boxes, edges, polygons, tetrahedra, triangles
from .spaces import CurlFree, DivergenceFree, Harmonic, Scalar, Space, Vector
from .stencils import Quality, Stencils, stencils
from .surface import Surface, surface
from .targets import (
    COEFFICIENTS,
    CURL,
    CURL_CURL,
    DIVERGENCE,
    GRADIENT,
    HESSIAN,
    JACOBIAN,
    LAPLACIAN,
    VALUE,
    Derivative,
    Dirichlet,
    Exact,
    ExactMean,
    Function,
    Integral,
    Mean,
    MeanAlong,
    MeanSlope,
    Neumann,
    Wanted,
)
from .weights import CardinalSpline, Cosine, CubicSpline, Gaussian, Power, Sigmoid, Weight

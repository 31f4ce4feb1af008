"""libCEED's operators at Gauss's points and its basis at points anywhere, as peers of amrpic.fem; None where it cannot be had.

Its version 0.12 has no operator at points: the gradient there and back is less than one.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from amrpic import fem

FUNCTIONS = {
    (fem.Mass, 1): "MassApply",
    (fem.Mass, 3): "Vector3MassApply",
    (fem.Poisson, 1): "Poisson3DApply",
    (fem.Poisson, 3): "Vector3Poisson3DApply",
}
Apply = Callable[[], Any]


def library() -> Any | None:
    """Return the package, or None."""
    try:
        return importlib.import_module("libceed")
    except ImportError:
        return None


def fastest() -> str:
    """Return the fastest of its resources that the processor runs; one that it lacks would end the process."""
    flags = Path("/proc/cpuinfo").read_text()
    return "/cpu/self/avx/blocked" if " avx2" in flags and " fma" in flags else "/cpu/self/opt/blocked"


class AtGauss:
    """An operator on all elements of a mesh of one rank, in the order of the mesh's vectors."""

    def __init__(self, mesh: fem.Mesh, kind: type[fem.Operator], components: int) -> None:
        libceed: Any = library()
        self.ceed = libceed.Ceed(fastest())
        p, q = mesh.degree + 1, mesh.degree + 1
        elements, nodes = len(mesh.elements), len(mesh.node_indices)
        offsets = (components * element_nodes(mesh)).astype(np.int32)
        points = q**3
        restriction = self.ceed.ElemRestriction(elements, p**3, components, 1, components * nodes, offsets.ravel())
        basis = self.ceed.BasisTensorH1Lagrange(3, components, p, q, libceed.GAUSS)
        width = 1 if kind is fem.Mass else 6
        strides = np.array([1, points, points * width], dtype=np.int32)
        of_points = self.ceed.StridedElemRestriction(elements, points, width, width * elements * points, strides)
        factors = self.ceed.Vector(width * elements * points)
        factors.set_array(point_factors(mesh, kind, elements).ravel(), cmode=libceed.COPY_VALUES)
        function = self.ceed.QFunctionByName(FUNCTIONS[kind, components])
        self.operator = self.ceed.Operator(function)
        of_nodes = ("u", "v") if kind is fem.Mass else ("du", "dv")
        active, none = libceed.VECTOR_ACTIVE, libceed.BASIS_NONE
        self.operator.set_field(of_nodes[0], restriction, basis, active)
        self.operator.set_field("qdata", of_points, none, factors)
        self.operator.set_field(of_nodes[1], restriction, basis, active)
        self.u, self.v = self.ceed.Vector(components * nodes), self.ceed.Vector(components * nodes)
        self.kept = (restriction, basis, of_points, factors, function)

    def set(self, u: np.ndarray) -> None:
        """Give the vector that `apply` multiplies."""
        self.u.set_array(np.ascontiguousarray(u).ravel())

    def apply(self) -> None:
        self.operator.apply(self.u, self.v)

    def result(self) -> np.ndarray:
        with self.v.array_read() as values:
            return values.copy()


def element_nodes(mesh: fem.Mesh) -> np.ndarray:
    """Return the numbers of each element's nodes among the rank's, (elements, nodes), x fastest."""
    place = np.empty(int(mesh.node_counts.prod()), dtype=np.int64)
    place[mesh.numbers] = np.arange(len(place))
    along = np.arange(mesh.degree + 1)
    k, j, i = np.meshgrid(along, along, along, indexing="ij")
    nx, ny, _ = mesh.node_counts
    within = (i + nx * (j + ny * k)).ravel()
    x, y, z = (mesh.elements.astype(np.int64) * mesh.degree).T
    return place[(x + nx * (y + ny * z))[:, None] + within]


def point_factors(mesh: fem.Mesh, kind: type[fem.Operator], elements: int) -> np.ndarray:
    """Return what functions at points multiply by: of each element (width, points)."""
    _, weight = np.polynomial.legendre.leggauss(mesh.degree + 1)
    w = np.einsum("k,j,i->kji", weight, weight, weight).ravel() * mesh.element_volume / 8
    if kind is fem.Mass:
        rows = w[None]
    else:
        zero = np.zeros_like(w)
        rows = np.stack([*(w * (2 / h) ** 2 for h in mesh.spacing), zero, zero, zero])
    return np.broadcast_to(rows, (elements, *rows.shape)).copy()


def gradient_there_and_back(mesh: fem.Mesh, components: int, per_element: int, elements: int) -> Apply:
    """Return a call that takes so many elements' gradients to as many random points in each, and back."""
    libceed: Any = library()
    cffi = importlib.import_module("_ceed_cffi")
    ceed = libceed.Ceed("/cpu/self/opt/serial")
    p = mesh.degree + 1
    basis = ceed.BasisTensorH1Lagrange(3, components, p, p, libceed.GAUSS)
    nodes, at = ceed.Vector(components * p**3), ceed.Vector(3 * per_element)
    back, slopes = ceed.Vector(components * p**3), ceed.Vector(3 * components * per_element)
    rng = np.random.default_rng(1)
    nodes.set_array(rng.uniform(size=components * p**3))
    at.set_array(rng.uniform(-1, 1, 3 * per_element))
    apply = cffi.lib.CeedBasisApplyAtPoints
    there = (basis._pointer[0], per_element, libceed.NOTRANSPOSE, libceed.EVAL_GRAD, at._pointer[0])
    again = (basis._pointer[0], per_element, libceed.TRANSPOSE, libceed.EVAL_GRAD, at._pointer[0])
    ends = (nodes._pointer[0], slopes._pointer[0], back._pointer[0])
    kept = (ceed, basis, nodes, at, back, slopes)

    def call() -> None:
        for _ in range(elements):
            if apply(*there, ends[0], ends[1]) or apply(*again, ends[1], ends[2]):
                raise RuntimeError(f"libCEED refused an apply at points: {kept[0]}")

    return call

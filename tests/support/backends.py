"""Which backends tests have: another default than the package's may be tried, and what a build lacks is skipped.

With AMRPIC_TEST_BACKEND=kokkos solvers and scenes that name no backend have this one, in order 2, and so have all clouds.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

DEFAULT = os.environ.get("AMRPIC_TEST_BACKEND", "matrix-free")
LACKS_TRILINOS = "needs Trilinos, and amrpic was built without it"
LACKS_DEVICE = "Kokkos finds no device"


def use_default() -> None:
    """Let this process execute by `DEFAULT` what names no backend."""
    if DEFAULT == "matrix-free":
        return
    from amrpic.particles.clouds import SHAPES, Clouds
    from amrpic.scene.scene import Scene
    from amrpic.scene.solver_options import SolverOptions

    native_values, to_dict = SolverOptions.native_values, Scene.to_dict

    def with_default(self: SolverOptions) -> dict[str, Any]:
        named = self.order != 2 or "backend" in self.model_fields_set
        return native_values(self) | ({} if named else {"backend": DEFAULT})

    def without_what_is_not_named(self: Scene) -> dict[str, Any]:
        """Else a restart would take the package's default in a checkpoint for one that was named."""
        values = to_dict(self)
        if "backend" not in self.solver.model_fields_set:
            values["solver"].pop("backend", None)  # a test may have left it out
        return values

    SolverOptions.native_values = with_default  # type: ignore[method-assign]
    Scene.to_dict = without_what_is_not_named  # type: ignore[method-assign, assignment]
    Clouds.native = property(lambda clouds: (SHAPES[clouds.shape], clouds.matched, DEFAULT == "kokkos"))  # type: ignore[assignment]


def has_trilinos() -> bool:
    from amrpic import _native

    return bool(_native.trilinos_version())


def on_a_card() -> bool:
    """Whether the default backend's kernels run on a graphics card."""
    from amrpic import _native

    return DEFAULT == "kokkos" and " on " in _native.kokkos_backend()


def same_sums(ours: np.ndarray, others: np.ndarray, rounding: float = 1e-13) -> bool:
    """Whether sums over the same particles are equal, or what follows of them: bit by bit, but on a card, which adds in any
    order, to `rounding` of the largest."""
    if not on_a_card():
        return np.array_equal(ours, others)
    return bool(np.allclose(ours, others, rtol=0, atol=rounding * np.max(np.abs(others), initial=0)))


def executed(backend: str) -> str:
    """The backend in whose place this one is wanted: the default for matrix-free, and for what the build lacks."""
    there = {"matrix-free": False, "crs": has_trilinos(), "kokkos": has_device()}
    return backend if there[backend] else DEFAULT


def has_device() -> bool:
    """Whether Kokkos' kernels, if they were built, can run here."""
    from amrpic import _native

    return LACKS_DEVICE not in _native.kokkos_backend()


def lack(error: BaseException) -> str:
    """What the build or the machine lacks, if that is why a test failed; else empty."""
    if LACKS_DEVICE in str(error) and not has_device():
        return f"no graphics card here: {error}"[:200]
    return f"this build has no Trilinos: {error}"[:200] if LACKS_TRILINOS in str(error) and not has_trilinos() else ""

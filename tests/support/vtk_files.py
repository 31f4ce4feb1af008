"""Files as VTK's own reader has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def vtk_read(path: Path) -> Any:
    """Return what a VTKHDF file holds, with all levels of a mesh."""
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.SetMaximumLevelsToReadByDefaultForAMR(0)  # all
    reader.Update()
    return reader.GetOutput()

"""A run as a class of LUME: configure, run, archive, plot (`pip install lume-base` to derive it from `lume.base.Base`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py

from ..errors import InputError
from ..scene.any_scene import read_data
from ..scene.scene import Scene
from .evaluate import LOG, assignments, last_of, name_of, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Base: type = object
else:
    try:
        from lume.base import Base
    except ImportError:
        Base = object


class Amrpic(Base):
    """A scene of amrpic, and what became of its run.

    `input`: values that replace some of the scene file, by their keys. `output`: the numbers of the last step, once it has run.
    """

    def __init__(
        self,
        input_file: str | None = None,
        *,
        initial_particles: Any = None,
        verbose: bool = False,
        timeout: float | None = None,
        folder: str | Path = "runs/lume",
        ranks: int = 1,
        **inputs: Any,
    ) -> None:
        """`folder`: where each run gets a folder of its own, `path`. `timeout` in s. `verbose`: print what a run printed."""
        if initial_particles is not None:
            raise InputError("initial_particles are not taken; name their openPMD file in the scene's bunches")
        super().__init__(*([] if Base is object else [input_file]))
        self._input_file, self._verbose, self._timeout = input_file, verbose, timeout
        self.folder, self.ranks = Path(folder), ranks
        self._input: dict[str, Any] = dict(inputs)
        self._output: dict[str, float] | None = None
        self._configured = self._finished = self._error = False
        self.scene: Scene | None = None
        if input_file is not None:
            self.configure()

    @property
    def input(self) -> dict[str, Any]:
        """Values of the scene by their keys; change them before `run`."""
        return self._input

    @input.setter
    def input(self, values: Mapping[str, Any]) -> None:
        self._input = dict(values)

    @property
    def output(self) -> dict[str, float] | None:
        """The numbers of the last step; None before a run."""
        return self._output

    @property
    def path(self) -> Path:
        """Where the run with this input writes."""
        return self.folder / name_of(self._input, self._file)

    @property
    def _file(self) -> str:
        if self._input_file is None:
            raise InputError("there is no input file; give the scene file")
        return self._input_file

    def configure(self) -> None:
        """Read the scene with its input. Raises SceneError in one sentence."""
        self._configured = False
        self.scene = Scene.from_data(read_data(self._file, assignments(self._input)), self._file)
        self._configured = True

    def run(self) -> dict[str, float]:
        """Run the scene, unless that has been done, and return the numbers of its last step."""
        self._output, self._finished, self._error = None, False, True
        self.configure()
        try:
            self._output = last_of(run(self._input, self._file, self.folder, self.ranks, self._timeout))
        finally:
            if self._verbose and (self.path / LOG).exists():
                print((self.path / LOG).read_text(encoding="utf-8"))
        self._finished, self._error = True, False
        return self._output

    def archive(self, h5: str | h5py.Group | None = None) -> str | h5py.Group:
        """Write input and output to an HDF5 file or group, and return it."""
        if not isinstance(h5, h5py.Group):
            path = str(h5 or self.path / "archive.h5")
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            with h5py.File(path, "w") as file:
                self.archive(file)
            return path
        h5.attrs["scene"] = "" if self.scene is None else self.scene.to_toml()
        h5.attrs["input"] = json.dumps(self._input)
        h5.attrs["output"] = json.dumps(self._output)
        h5.attrs["input_file"], h5.attrs["folder"] = self._file, str(self.folder)
        return h5

    def load_archive(self, h5: str | h5py.Group, configure: bool = True) -> None:
        """Take up what `archive` wrote."""
        if not isinstance(h5, h5py.Group):
            with h5py.File(h5, "r") as file:
                return self.load_archive(file, configure)
        self._input, self._output = json.loads(h5.attrs["input"]), json.loads(h5.attrs["output"])
        self._input_file, self.folder = str(h5.attrs["input_file"]), Path(str(h5.attrs["folder"]))
        if configure and Path(self._file).exists():
            self.configure()
        return None

    def plot(self) -> Figure:
        """Return a picture of the beam along the run."""
        from ..results.curves import BEAM, draw
        from ..results.run_results import rows_of

        return draw(rows_of(self.path), BEAM)

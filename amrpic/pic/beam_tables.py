"""Tables of what is measured of the beam: a row per group of particles, or per slice of it, at some steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..errors import InputError
from ..io.provenance import Provenance
from ..io.time_series import Series
from ..mesh.domain import AXES
from ..mesh.periods import LARGEST_FILL
from ..mpi import MPI
from ..parallel import call_together
from ..particles.groups import Groups
from ..scene.scene import Scene
from ..stages.beam_diagnostics import (
    FRACTIONS,
    PartMoments,
    Quantiles,
    Slice,
    Value,
    group_losses,
    group_quantiles,
    group_slices,
    group_values,
    moments_by_kind,
    slice_values,
)
from ..units import Column
from .state import State


class Fills:
    """Remarks on groups whose nearest images say little of their size, one for each group and axis."""

    def __init__(self, remark: Callable[[str], None]) -> None:
        self._remark = remark
        self._said: set[tuple[str, int]] = set()

    def check(self, fills: Mapping[str, np.ndarray]) -> None:
        """Remark on groups by name whose rms size round an axis over its period, `fills` (3,) each, is too large."""
        for axis, letter in enumerate(AXES):
            full = {
                name: float(fill[axis])
                for name, fill in fills.items()
                if fill[axis] > LARGEST_FILL and (name, axis) not in self._said
            }
            if full:
                self._said |= {(name, axis) for name in full}
                most = max(full.values())
                size = "is even" if most > 1 else f"has an rms size of {most:.2g} of that"
                self._remark(
                    f"{', '.join(full)}: the beam takes up the period along {letter} ({size}, where nearest images serve up to "
                    f"{LARGEST_FILL:.2g}), so its mean, size and emittance along {letter} depend on where the period is cut"
                )


BEAM = "beam.csv"
SLICES = "slices.csv"
TIME = (Column("step", counts=True), Column("time", "s"), Column("s", "m"))
OF_TIME = [column.name for column in TIME]
GROUP = (*TIME, Column("group", is_text=True))
SLICE = (*GROUP, Column("slice", counts=True))

Diagnostic = Callable[[State], Mapping[str, float | np.ndarray | Sequence[float]]]


def groups_of(state: State, scene: Scene) -> Groups:
    """Return the groups of particles of a run."""
    return Groups.of(state.particles.species, scene.named_bunches())


class BeamTables:
    """The tables of one run, open for appending. Collective to make, and in all that it does.

    Rows after `keep_to_step` are cut off. `own` are diagnostics of a script, by their names.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        state: State,
        scene: Scene,
        about: Provenance,
        keep_to_step: int | None,
        own: Mapping[str, Diagnostic],
        fills: Fills,
    ) -> None:
        self._comm, self._about, self._keep = comm, about, keep_to_step
        self._every, self._slices = scene.diagnostics.every, scene.diagnostics.slices
        self._directory = scene.directory
        self._period = scene.domain.value.period(2)
        self._groups = groups_of(state, scene)
        self._own, self._fills = own, fills
        self._series: dict[str, Series] = {}
        self._last = keep_to_step if keep_to_step is not None and self._is_due(keep_to_step) else None
        if self._every and (scene.bunches or scene.sources):
            self._open(BEAM, [*GROUP, *_columns(group_values(*NOTHING))])
            if self._slices:
                self._open(SLICES, [*SLICE, *_columns(slice_values(Slice(0.0, 0.0, NOTHING[0])))])

    def _open(self, name: str, columns: Sequence[Column]) -> Series:
        if name not in self._series:
            self._series[name] = Series(self._comm, self._directory / name, columns, self._about, self._keep)
        return self._series[name]

    def _is_due(self, step: int) -> bool:
        return self._every > 0 and step % self._every == 0

    @property
    def series(self) -> list[Series]:
        """The files; rows that are added to them are to be settled."""
        return list(self._series.values())

    def record(self, state: State) -> None:
        """Add the rows of a state if they are due; the caller settles."""
        if self._is_due(state.step):
            self.record_now(state)

    def record_now(self, state: State) -> None:
        """Add the rows of a state unless they are there; the caller settles."""
        if self._every == 0 or self._last == state.step:
            return
        self._last = state.step
        if BEAM in self._series:
            self._record_beam(state)
        for name, diagnostic in self._own.items():
            self._record_own(state, name, diagnostic)

    def _record_beam(self, state: State) -> None:
        comm, groups = self._comm, self._groups
        moments: dict[frozenset[int], PartMoments] = {}
        quantiles: dict[frozenset[int], Quantiles] = {}
        slices: dict[frozenset[int], list[Slice]] = {}
        for beam, of_kinds, parts in moments_by_kind(comm, state.beam, groups, state.hierarchy.domain):
            moments |= parts
            quantiles |= group_quantiles(comm, beam, of_kinds, parts)
            if SLICES in self._series:
                slices |= group_slices(comm, beam, of_kinds, parts, self._slices)
        lost = group_losses(comm, state.lost.particles, groups)
        at: dict[str, float | str] = {"step": state.step, "time": state.time, "s": state.course.path}
        named = list(zip(groups.names, groups.members, strict=True))
        self._fills.check({name: moments[members].images.fill for name, members in named})
        self._series[BEAM].add(
            *(
                {
                    **at,
                    "group": name,
                    **_row(group_values(moments[members], quantiles[members], lost[members], self._period)),
                }
                for name, members in named
            )
        )
        if SLICES in self._series:
            self._series[SLICES].add(
                *(
                    {**at, "group": name, "slice": number, **_row(slice_values(of_slice))}
                    for name, members in named
                    for number, of_slice in enumerate(slices[members])
                )
            )

    def _record_own(self, state: State, name: str, diagnostic: Diagnostic) -> None:
        values = call_together(
            self._comm, lambda: flattened(diagnostic(state)), InputError, f'the diagnostic "{name}" failed'
        )
        series = self._open(file_of(name), [*TIME, *(Column(column) for column in values)])
        names = [column.name for column in series.columns[len(TIME) :]]
        if self._comm.allreduce(names != list(values), MPI.LOR):
            raise InputError(
                f'the diagnostic "{name}" gives other values at step {state.step} than before; give the same ones in the same '
                "shapes each time"
            )
        series.add({"step": state.step, "time": state.time, "s": state.course.path, **values})

    def sync(self) -> None:
        """Force all rows to storage. Collective; raises OutputError."""
        for series in self._series.values():
            series.sync()

    def close(self) -> None:
        """Close the files."""
        for series in self._series.values():
            series.close()


NOTHING = (
    PartMoments(
        0, 0.0, 0.0, 0.0, 0.0, np.zeros(3), np.zeros(7), np.zeros((7, 7)), np.zeros((3, 5, 5)), np.zeros(7), np.zeros(7)
    ),
    Quantiles(np.zeros((3, len(FRACTIONS))), np.zeros(len(FRACTIONS)), np.zeros(len(FRACTIONS))),
    (0, 0.0),
)  # fmt: skip


def file_of(name: str) -> str:
    """Return the file of a script's own diagnostic."""
    return f"own_{name}.csv"


def flattened(values: Mapping[str, float | np.ndarray | Sequence[float]]) -> dict[str, float]:
    """Return numbers and the elements of arrays, each by a name of its own: `a`, or `a_0_1` of an array.

    Raises ValueError for names that a table cannot have, and for two columns of one name.
    """
    out: dict[str, float] = {}
    for name, value in values.items():
        array = np.asarray(value, dtype=np.float64)
        for place in np.ndindex(array.shape):
            column = "_".join([name, *map(str, place)])
            if column in out or column in OF_TIME:
                raise ValueError(f'two columns are called "{column}"; give one of them another name')
            if {",", "\n"} & set(column):
                raise ValueError(f"{column!r} is no name of a column; leave commas and line ends out")
            out[column] = float(array[place])
    return out


def _columns(values: Sequence[Value]) -> list[Column]:
    return [column for column, _ in values]


def _row(values: Sequence[Value]) -> dict[str, float]:
    return {column.name: value for column, value in values}

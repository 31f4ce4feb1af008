"""Electrodes as a solver sees them: which cells of a level lie in metal, and which arms it cuts."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError, SolverError
from ..mpi import MPI
from ..parallel import together
from ..shapes.spans import Floats
from .arms import TOUCH, GrownBoxes, Lattice, arms_of_boxes, cut_cells, indices, trace, traced_boxes
from .conductor import Conductor
from .contacts import Contact, LineSpans, apart, contacts, narrowest, sentence, sentence_at_wall, sentence_of_gap
from .gaps import NO_GAPS, Gaps
from .gaps import gaps as gaps_on

# Lines by which two electrodes are compared without a mesh: so many at least along each side of where both can be, halving the
# spacing at most so often, and about so many at most along each axis.
FEWEST_LINES, MOST_HALVINGS, MOST_LINES = 64, 12, 2**17
Answer = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Seen(NamedTuple):
    """What boxes of a level have of electrodes."""

    answer: Answer  # first cells, lengths and electrodes of runs in metal, cut cells, their arms and what cuts these
    gaps: Gaps
    contacts: list[Contact]

    def digest(self) -> bytes:
        """Return bytes that answers and gaps share with equal ones alone."""
        digest = hashlib.blake2b(digest_size=16)
        for part in (*self.answer, *self.gaps):
            digest.update(np.ascontiguousarray(part).data)
            digest.update(b"%d" % len(part))
        return digest.digest()


@dataclass
class Question:
    """What a native solver asked for: cells in boxes, of this spacing."""

    boxes: Sequence[Sequence[int]]
    spacing: Sequence[float]
    digest: bytes = b""  # of the answer; found when it is first compared with another


class MetalOnMesh:
    """Electrodes for a native solver, whose lengths are those of a domain from `lower` on, times `stretch`.

    `walls` (2, 3): lower and upper faces of the domain that hold a potential, m; infinite where none does.
    """

    def __init__(
        self,
        electrodes: Sequence[Conductor],
        lower: Sequence[float],
        walls: ArrayLike,
        stretch: Sequence[float] = (1, 1, 1),
    ) -> None:
        self._electrodes, self._lower, self._stretch = tuple(electrodes), lower, np.array(stretch, float)
        self._walls = np.asarray(walls, float)
        self._contacts: list[Contact] = []
        self._gaps: list[tuple[Sequence[float], Gaps]] = []
        self._questions: list[Question] = []

    def native(self) -> _native.Metal:
        """Return what a native solver asks; it keeps this object alive."""
        return _native.Metal(len(self._electrodes), self._ask)

    def gaps(self, spacing: ArrayLike) -> Gaps:
        """Return the gaps on lines of cells of a spacing (3,), m, that this rank has asked about, each once. Local."""
        widths = np.multiply(spacing, self._stretch)
        parts = [NO_GAPS, *(gaps for asked, gaps in self._gaps if np.allclose(asked, widths, rtol=1e-9, atol=0))]
        arms, width = (np.concatenate(column) for column in zip(*parts, strict=True))
        each = np.unique(arms, axis=0, return_index=True)[1]
        return Gaps(arms[each], width[each])

    def finish(self) -> None:
        """Raise SolverError, if electrodes of different voltages touch where this rank has asked. Local."""
        if self._contacts:
            raise SolverError(sentence(self._electrodes, self._contacts[0]))

    def becomes(self, electrodes: Sequence[Conductor], comm: MPI.Comm) -> bool:
        """Let other electrodes take the place of these where all answers stay as they are; return whether they do. Collective.

        They stay to the last digit if no electrode has moved, or a pipe along itself.
        """
        if [electrode.name for electrode in electrodes] != [electrode.name for electrode in self._electrodes]:
            return False
        if [electrode.shape for electrode in electrodes] != [electrode.shape for electrode in self._electrodes]:
            with together(comm, SolverError):
                # coarse levels first: these take no time
                questions = sorted(self._questions, key=lambda question: len(question.boxes))
                same = all(
                    self._seen(electrodes, question).digest() == self._digest(question) for question in questions
                )
            if not comm.allreduce(same, MPI.LAND):
                return False
        self._electrodes = tuple(electrodes)
        return True

    def _ask(self, boxes: Sequence[Sequence[int]], spacing: Sequence[float]) -> Answer:
        question = Question(boxes, spacing)
        seen = self._seen(self._electrodes, question)
        self._contacts += seen.contacts
        if len(seen.gaps.width):
            self._gaps.append((spacing, seen.gaps))
        self._questions.append(question)
        return seen.answer

    def _digest(self, question: Question) -> bytes:
        question.digest = question.digest or self._seen(self._electrodes, question).digest()
        return question.digest

    def _seen(self, electrodes: Sequence[Conductor], question: Question) -> Seen:
        lattice = Lattice.of(self._lower, np.divide(question.spacing, self._stretch))
        cells, owner, crossings, lines = traced_boxes(electrodes, question.boxes, lattice.origin, lattice.spacing)
        cut = cut_cells(cells, owner, crossings)
        answer = (
            *_native.runs_in_metal(np.asarray(question.boxes, np.int32), owner),
            indices(question.boxes, cut.cell, cut.first),
            cut.theta,
            cut.electrode,
        )
        touching = contacts(electrodes, lines, TOUCH * lattice.spacing)
        return Seen(answer, gaps_on(lines, lattice, self._walls), list(touching))


def refuse_contacts(
    electrodes: Sequence[Conductor],
    origin: Sequence[float],
    spacing: Sequence[float],
    walls: Sequence[Conductor] = (),
) -> list[str]:
    """Raise InputError if electrodes of different voltages touch or overlap; the same on all ranks.

    What solvers look for on the lines of their meshes is looked for here wherever two electrodes can be, on those of cells of
    this `spacing`, m, or of finer ones where few would pass there. Returns a sentence on each two with a gap along an axis in
    which no such cell has its centre, and on each electrode that meets one of the `walls`, metal behind faces of the domain, at
    another potential.
    """
    cells, out, metal = Lattice.of(origin, spacing), [], [*electrodes, *walls]
    for first, second in apart(metal):
        two, is_wall = [metal[first], metal[second]], second >= len(electrodes)
        if first >= len(electrodes):
            continue
        lattice, lines = _lines_of_both(two, cells)
        if not lines:
            continue
        contact = next(contacts(two, lines, TOUCH * lattice.spacing), None)
        if contact is not None and not is_wall:
            raise InputError(sentence(two, contact))
        if contact is not None:
            out.append(sentence_at_wall(two, contact))
            continue
        of_axes = (narrowest(one, other, partial(cells.index, one.axis)) for one, other in zip(*lines, strict=True))
        gaps = [gap for gap in of_axes if gap is not None]
        if gaps:
            out.append(sentence_of_gap(two, min(gaps)))
    return out


def _lines_of_both(two: Sequence[Conductor], cells: Lattice) -> tuple[Lattice, list[list[LineSpans]]]:
    """Return the lattice of lines by which two electrodes are compared where both can be, or between them if that is less than
    a cell, and their spans on these lines along x, y and z; none where they are farther apart."""
    bounds = np.array([electrode.shape.bounds for electrode in two])
    size = 2 * np.abs(bounds[np.isfinite(bounds)]).max(initial=0.0)  # of half spaces
    lower, upper = np.clip(bounds[:, 0].max(axis=0), -size, size), np.clip(bounds[:, 1].min(axis=0), -size, size)
    if (lower > upper + cells.spacing).any():
        return cells, []
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    lattice = _lattice_through(upper - lower, cells)
    ends = [[lattice.index(axis, place[axis]) for axis in range(3)] for place in (lower, upper)]
    boxes = GrownBoxes.around(np.array([[*np.floor(ends[0]), *np.ceil(ends[1])]], np.int64))
    return lattice, [[traced.lines for traced in trace(electrode.shape, boxes, lattice)] for electrode in two]


def _lattice_through(extent: Floats, lattice: Lattice) -> Lattice:
    """Return a lattice of as many lines through a box of this extent (3,), m, as electrodes are compared by."""
    count = extent / lattice.spacing
    with np.errstate(divide="ignore"):
        halvings = np.clip(np.ceil(np.log2(FEWEST_LINES / count)), 0, MOST_HALVINGS)
    lines = np.maximum(count * 2**halvings, 1.0)
    doublings = max(0.0, np.ceil(np.log2(lines.prod() / lines.min() / MOST_LINES) / 2))
    return Lattice(lattice.origin, lattice.spacing * 2.0 ** (doublings - halvings))


def image_refusal(
    electrodes: Sequence[Conductor], lattice: Lattice, boxes: np.ndarray, cells: Sequence[int], periodic: Sequence[bool]
) -> str | None:
    """Return why electrodes at periodic faces are refused, and what to do: metal must continue in the same way behind them.

    `boxes` (n, 6) are those of a level, `cells` the number that it would have along each axis of the domain.
    """
    for axis in (axis for axis in range(3) if periodic[axis]):
        at_faces = boxes[(boxes[:, axis] == 0) | (boxes[:, axis + 3] == cells[axis] - 1)].astype(np.int64)
        layers = []  # of cells inside and outside, at both faces
        for index in (-1, 0, cells[axis] - 1, cells[axis]):
            at_faces[:, [axis, axis + 3]] = index
            layers.append(arms_of_boxes(electrodes, at_faces, lattice.origin, lattice.spacing)[0])
        for inside, outside in ((layers[1], layers[3]), (layers[2], layers[0])):
            same = np.array_equal(inside.solid, outside.solid) and np.array_equal(inside.cell, outside.cell)
            if not same or not np.allclose(inside.theta, outside.theta, atol=1e-6):
                return (
                    f"an electrode meets a periodic face across {'xyz'[axis]}, beyond which it does not go on as at the other "
                    "one; let it pass through both alike, or end a cell before them"
                )
    return None

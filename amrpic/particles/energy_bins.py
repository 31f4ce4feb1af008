"""Parts of a beam, each solved for in a frame of its own: bins of velocity along an axis, signs of charge."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..mesh.domain import AXES, Domain
from ..mesh.mirror import SIGNS, Mirror, leaves_no_way_round, sides_along
from ..mesh.window import vector
from ..mpi import MPI
from .arrays import empty_columns
from .frame import LABORATORY, SLOW, STATIC, Frame
from .motion_of_charge import Flow, Left, charges, flow, largest, left, mean_momentum, noise, rapidity, squares
from .motion_of_charge import momenta as momenta_of
from .particles import Particles
from .species import LARGEST_MOMENTUM

WIDTH = 0.2  # of rapidity in a bin that is chosen by itself: γ differs by a tenth to either side
CELL = WIDTH / 8  # of rapidity, in which charge is counted
WIDE = 0.01  # <β²> along the axis in a part's frame beyond that across, above which it is divided although it has no current
CURRENT = (
    WIDTH**2 / 12
)  # mean square of mean velocities over c in a part's frame, above which it is divided: that of a bin
MOST = 16  # frames that are chosen by themselves
FEW = 1e-3  # of the force of a neighbour: bins that change it by less join it
FREE = 1.0  # error of the force over <β²> / (1 - <β²>) of free motion in the frame: docs/reports/verification.md
BOTH_WAYS = (
    0.01  # weight of <u²> beside <u>² in the choice of the axis: beams may move both ways along it, and be warm across
)
OFF_AXIS = 0.1  # rad / γ between the mean velocity and a mesh axis
SURE = 4.0  # standard deviations of a mean by which a sample may be off
SAME = 1e-6  # relative change of β γ below which a frame is kept, and the solver with it
SAMPLE = 50_000  # particles of which the errors are estimated
CHANGE = 1.5  # either way, of what is left of motion in the frames since parts were chosen, beyond which they are chosen anew
LEAST = 1e-5  # of <β²> that counts for that: about (2 FEW)² / (CHANGE - 1), where charges of both signs begin to drift


class Charge(NamedTuple):
    """Charge of a bin."""

    bin: int = 0
    sign: int = 0  # 1, -1; 0: of both signs


Part = tuple[Charge, ...]
ALL: Part = (Charge(),)


@dataclass(frozen=True)
class Frames:
    """The frames of the parts of a beam, in ascending order of velocity along an axis."""

    members: tuple[Frame, ...] = (LABORATORY,)
    axis: int = 2
    edges: tuple[float, ...] = ()  # rapidities along the axis between the bins
    of: tuple[Part, ...] = (ALL,)  # whose frames the members are
    error: float = field(
        default=0.0, compare=False
    )  # of the force of the charge on itself, estimated: what the frames leave out
    across: float = field(default=0.0, compare=False)  # of it by momenta across the axis
    moves: tuple[float, float, float] = field(
        default=(0.0, 0.0, 0.0), compare=False
    )  # β γ of all momentum when they were made
    motion: tuple[tuple[float, ...], ...] = field(
        default=(), compare=False
    )  # what is left of it in each, of `_motion`, when parts were chosen
    turn: tuple[tuple[float, ...], ...] | None = field(
        default=None, compare=False
    )  # matrix that turns momenta, which lag places, along the axes of a mesh that turns as they would; None: it does not
    mirror: Mirror | None = field(default=None, compare=False)  # of the walls across the motion
    leaves: bool = field(default=False, compare=False)  # whether the mesh goes on from the wall in which it mirrors

    @property
    def only(self) -> Frame | None:
        """The frame, if there is one."""
        return self.members[0] if len(self.members) == 1 else None

    def mirror_of(self, frame: Frame) -> Mirror | None:
        """Return the mirror by which the field of a member is solved for: of slow ones, walls at the mesh do as they are."""
        return self.mirror if self.leaves or frame.is_fast else None

    def reflects(self, frame: Frame) -> bool:
        """Whether the charge of a member has images that move against it."""
        mirror = self.mirror_of(frame)
        return mirror is not None and mirror.reflects

    @property
    def images(self) -> Frames | None:
        """The frames of the images that move against their charge; None without any."""
        members = tuple(frame.reversed for frame in self.members if self.reflects(frame))
        return Frames(members, self.axis) if members else None

    def parts(self, particles: Particles) -> Iterator[Particles]:
        """Yield for each member the particles, with the weight that is its."""
        yield from _parts(particles if self.of == (ALL,) else self.straight(particles), self.axis, self.edges, self.of)

    def straight(self, particles: Particles) -> Particles:
        """Return the particles with momenta along the axes of the mesh as they are at the time of their places.

        A mesh that turns with a beam has turned on since the time of momenta that lag.
        """
        if self.turn is None:
            return particles
        momentum = empty_columns(len(particles))
        np.matmul(np.array(self.turn), particles.momentum.T, out=momentum.T)
        return particles.replace(momentum=momentum)


ONE_FRAME = Frames()  # that of the laboratory


def _parts(particles: Particles, axis: int, edges: Sequence[float], of: Sequence[Part]) -> Iterator[Particles]:
    if tuple(of) == (ALL,):
        yield particles
        return
    number = (
        np.searchsorted(edges, rapidity(particles, axis), side="right")
        if edges
        else np.zeros(len(particles), dtype=np.int64)
    )
    for part in of:
        chosen = np.zeros(len(particles), dtype=bool)
        for bin, sign in part:
            chosen |= (number == bin) & (True if sign == 0 else np.sign(particles.charge) == sign)
        yield particles.with_weight(particles.weight * chosen)


def frames_of(
    comm: MPI.Comm,
    particles: Particles,
    domain: Domain,
    choice: str = "auto",
    bins: int | None = 1,
    last: Frames = ONE_FRAME,
) -> Frames:
    """Return the frames in which to solve for the field of the particles. Collective; InputError on all ranks.

    `choice`: "lab"; "rest", each part in the frame in which its charge rests in the mean; or "auto", the laboratory for slow
    parts, and below β² = 0.01 for those that move along no mesh axis or across walls. `bins`: so many frames at most, None: as
    many as the motion of the charge asks for. Parts are those of `last`, the frames of the step before, until the motion that
    is left in these has changed by the factor `CHANGE` since they were chosen. So they follow from the motion, and not from
    the number of steps.
    """
    if choice != "rest" and (most := largest(comm, particles)) < STATIC:
        return replace(ONE_FRAME, error=most)
    moves = mean_momentum(comm, particles)
    if last.motion:
        stays = last.only == LABORATORY and moves @ moves < STATIC
        if stays or np.linalg.norm(moves - last.moves) <= SAME * np.linalg.norm(moves):
            frames = last
        else:
            frames, flows = _framed(comm, particles, domain, choice, last, (last.axis, last.edges, last.of))
            frames = replace(frames, error=last.error, across=last.across, motion=last.motion, moves=vector(moves))
            _require_slow_in_laboratory(comm, particles, domain, choice, frames, flows)
        if not _has_changed(_motion(comm, particles, frames), last.motion):
            return frames
    mean, square = momenta_of(comm, particles)
    if not square.sum() <= LARGEST_MOMENTUM**2:
        raise InputError(
            f"the rms momentum is {math.sqrt(square.sum()):.3g} m c, more than {LARGEST_MOMENTUM:g}; correct momenta "
            "(kg m/s) or fields, or shorten the time step"
        )
    axis = int(np.argmax(mean**2 + BOTH_WAYS * square))
    one_frame = choice == "lab" or bins == 1
    edges, groups = ((), [ALL]) if one_frame else _divided(comm, particles, axis, bins)
    frames, flows = _framed(comm, particles, domain, choice, last, (axis, edges, groups))
    frames = _errors(comm, particles, frames, flows)
    _require_slow_in_laboratory(comm, particles, domain, choice, frames, flows)
    return replace(frames, moves=vector(moves), motion=_motion(comm, particles, frames))


def _framed(
    comm: MPI.Comm,
    particles: Particles,
    domain: Domain,
    choice: str,
    last: Frames,
    divided: tuple[int, tuple[float, ...], Sequence[Part]],
) -> tuple[Frames, list[Flow]]:
    """Return the frames of parts, and how the charge of each moves. Collective; InputError on all ranks."""
    axis, edges, groups = divided[0], divided[1], list(divided[2])
    flows = [flow(comm, part, axis) for part in _parts(particles, axis, edges, groups)]
    if choice != "lab":
        _require_along(comm, particles, domain, axis, (edges, groups), flows)
    momenta = [_momentum(flow, domain, axis, choice) for flow in flows]
    if momenta.count(0.0) > 1:  # one solve for all of the laboratory
        at_rest = [n for n, u in enumerate(momenta) if u == 0]
        groups[at_rest[0]] = tuple(charge for n in at_rest for charge in groups[n])
        for n in reversed(at_rest[1:]):
            del groups[n], momenta[n]
        flows = [flow(comm, part, axis) for part in _parts(particles, axis, edges, groups)]
    members = tuple(Frame(axis, u) if u else LABORATORY for u in momenta)
    return _kept(Frames(members, axis, edges, tuple(groups)), last), flows


def _motion(comm: MPI.Comm, particles: Particles, frames: Frames) -> tuple[tuple[float, ...], ...]:
    """Return what is left of motion of each part in its frame: <β_d²>, and <β_d>² of the charge with its sign. Collective."""
    parts = _parts(_some(comm, particles), frames.axis, frames.edges, frames.of)
    sums = comm.allreduce(np.array([squares(part, frame) for part, frame in zip(parts, frames.members, strict=True)]))
    means = np.divide(sums[:, 1:], sums[:, :1], out=np.zeros((len(sums), 6)), where=sums[:, :1] != 0)
    return tuple(map(tuple, (means ** (1, 1, 1, 2, 2, 2)).tolist()))


def _has_changed(motion: Sequence[Sequence[float]], before: Sequence[Sequence[float]]) -> bool:
    """Whether motion that is left is more or less than it was, or of other parts."""
    now, previous = (np.maximum(np.array(of), LEAST) for of in (motion, before))
    return now.shape != previous.shape or not (np.abs(np.log(now / previous)) <= math.log(CHANGE)).all()


def _require_slow_in_laboratory(
    comm: MPI.Comm, particles: Particles, domain: Domain, choice: str, frames: Frames, flows: Sequence[Flow]
) -> None:
    """Raise InputError on all ranks if the laboratory is chosen for charge whose magnetic field counts."""
    if _walls(domain, frames.axis) and leaves_no_way_round(domain, frames.axis):
        return  # no other frame is better
    if choice == "lab" and (error := max(frames.error - frames.across, flows[0].beta @ flows[0].beta)) > SLOW:
        speed = math.sqrt(left(comm, particles, LABORATORY).square.sum())
        raise InputError(
            f'motion.frame is "lab", but the particles move with {speed:.3g} c, where their magnetic field counts, by about '
            f'{error:.1%} of the force; use "rest" or "auto"'
        )


def _momentum(flow: Flow, domain: Domain, axis: int, choice: str) -> float:
    """Return β γ of the frame of a part, 0 for the laboratory."""
    u = flow.momentum(axis)
    square = u * u / (1 + u * u)
    if choice == "lab" or (choice == "auto" and square < STATIC):
        return 0.0
    stays = _off_axis(flow, axis) > OFF_AXIS or bool(_walls(domain, axis))
    return 0.0 if choice == "auto" and square <= SLOW and stays else u


def _off_axis(flow: Flow, axis: int) -> float:
    """Return the angle between mean velocity and axis times γ."""
    across = np.linalg.norm(np.delete(flow.beta, axis))
    return float(across / abs(flow.beta[axis]) / math.sqrt(flow.per_gamma_square)) if across > 0 else 0.0


def _walls(domain: Domain, axis: int) -> list[str]:
    return [kind for kind in domain.boundary[axis] if kind in SIGNS]


def _require_along(
    comm: MPI.Comm,
    particles: Particles,
    domain: Domain,
    axis: int,
    divided: tuple[tuple[float, ...], list[Part]],
    flows: Sequence[Flow],
) -> None:
    """Raise InputError on all ranks for fast charge that moves off the axis by more than chance, or between walls across that
    leave its current no way round.

    All parts that move the same way are judged together.
    """
    for way in (1, -1):
        fast = [n for n, flow in enumerate(flows) if flow.beta[axis] * way > 0 and flow.beta[axis] ** 2 > SLOW]
        if not fast:
            continue
        speed = max(abs(flows[n].beta[axis]) for n in fast)
        if _walls(domain, axis) and leaves_no_way_round(domain, axis):
            sides = " or ".join(sorted(sides_along(domain, axis)))
            raise InputError(
                f"a face across the motion along {AXES[axis]} is {_walls(domain, axis)[0]} and all sides are {sides}, "
                f"round which particles of {speed:.3g} c have no magnetic field for their current; make a side "
                f'"open" or "dirichlet", or both faces of {AXES[axis]} "open" or "periodic", or set motion.frame to "lab" '
                "for a field without one"
            )
        along = sum(flows[n].charge * abs(flows[n].beta[axis]) for n in fast)
        across = [np.delete(flows[n].charge * flows[n].beta, axis) for n in fast]
        in_frames = sum(flow / math.sqrt(flows[n].per_gamma_square) for n, flow in zip(fast, across, strict=True))
        off = float(np.linalg.norm(in_frames) / along)
        if off <= OFF_AXIS:
            continue
        parts = _parts(particles, axis, divided[0], [divided[1][n] for n in fast])
        chances = [
            flows[n].charge ** 2 * noise(comm, part, flows[n], axis) for n, part in zip(fast, parts, strict=True)
        ]
        limit = OFF_AXIS + SURE * math.sqrt(sum(chances)) / along
        if off > limit:
            angle = float(np.linalg.norm(sum(across)) / along)
            raise InputError(
                f"the mean velocity lies {angle:.3g} rad off the {AXES[axis]} axis, more than {limit * angle / off:.3g}, which "
                "is 0.1/γ and what chance allows; the self-field of a fast beam is known along mesh axes alone: turn the scene "
                "so that the beam moves along one"
            )


# ---- division along the axis ----


def _divided(comm: MPI.Comm, particles: Particles, axis: int, bins: int | None) -> tuple[tuple[float, ...], list[Part]]:
    """Return the rapidities between the bins of particles, and their parts by sign of charge. Collective."""
    values, weighs = rapidity(particles, axis), charges(particles)
    low, high = _range(comm, values[weighs > 0])
    edges: tuple[float, ...] = ()
    if bins is None and high > low:
        edges = _by_current(comm, particles, axis, values, weighs, low, high)
    elif bins is not None and high > low:
        edges = tuple(np.linspace(low, high, bins + 1)[1:-1].tolist())
    if edges:
        number = np.searchsorted(edges, values, side="right")
        sums = [np.bincount(number, weight, len(edges) + 1) for weight in (weighs, weighs * values)]
        charge, first = comm.allreduce(np.array(sums))
        edges = _joined(edges, charge, first, MOST if bins is None else bins)
    groups: list[Part] = []
    for bin in range(len(edges) + 1):
        signs: list[Part] = [(Charge(bin, -1),), (Charge(bin, 1),)]
        room = bins is None or len(edges) + 1 + len(groups) - bin < bins
        drifts = room and _drift(comm, particles, axis, edges, signs)
        groups += signs if drifts else [(Charge(bin),)]
    return edges, groups


def _by_current(
    comm: MPI.Comm, particles: Particles, axis: int, values: np.ndarray, weighs: np.ndarray, low: float, high: float
) -> tuple[float, ...]:
    """Return the rapidities between beams, and within those whose own currents or widths ask for it. Collective.

    Beams are separate where no charge has a rapidity between them, for as much as a bin is wide.
    """
    first = math.floor(low / CELL)
    count = math.floor(high / CELL) - first + 1
    cells = np.floor(values / CELL).astype(np.int64) - first
    used = weighs > 0
    filled = np.flatnonzero(comm.allreduce(np.bincount(cells[used], minlength=count)))
    runs = np.split(filled, np.flatnonzero(np.diff(filled) * CELL > WIDTH) + 1)
    ends = [((run[0] + first) * CELL, (run[-1] + 1 + first) * CELL) for run in runs]
    between = [(one[1] + other[0]) / 2 for one, other in pairwise(ends)]
    inner: list[float] = []
    parts = _parts(particles, axis, between, [(Charge(n),) for n in range(len(runs))])
    for (lower, upper), part in zip(ends, parts, strict=True):
        if upper - lower <= WIDTH + 2 * CELL and min(upper, high) - max(lower, low) <= WIDTH:
            continue
        of = left(comm, _some(comm, part), Frame(axis, flow(comm, part, axis).momentum(axis)))
        if of.current[axis] > CURRENT or of.square[axis] - np.delete(of.square, axis).mean() > WIDE:
            inner += np.linspace(max(lower, low), min(upper, high), math.ceil((upper - lower) / WIDTH) + 1)[
                1:-1
            ].tolist()
    return tuple(sorted(float(edge) for edge in between + inner))


def _joined(edges: Sequence[float], charge: np.ndarray, first: np.ndarray, most: int) -> tuple[float, ...]:
    """Return the edges between bins that are left when those join a neighbour that change no force by much. Local.

    `charge` of each bin, and its sum times rapidity. In the frame of any bin c charge of a that is taken to move with b is off
    by Q_a γ_c |β_c| |β_a - β_b|; it is compared with all charge there, Σ Q cosh(y_c - y) / cosh(y).
    """
    borders, total, moment = list(edges), charge.tolist(), first.tolist()
    while borders:
        q = np.array(total)
        y = np.divide(moment, q, out=np.zeros(len(q)), where=q > 0)
        per_charge = np.abs(np.sinh(y[q > 0])) / (np.cosh(y[q > 0, None] - y) @ (q / np.cosh(y)))
        distance = np.sinh(np.abs(np.diff(y))) / (np.cosh(y[1:]) * np.cosh(y[:-1]))
        costs = distance * np.minimum(q[1:], q[:-1]) * per_charge.max(initial=0.0)
        n = int(np.argmin(costs))
        if not (costs[n] < FEW or len(q) > most):
            break
        del borders[n]
        total[n : n + 2], moment[n : n + 2] = [total[n] + total[n + 1]], [moment[n] + moment[n + 1]]
    return tuple(borders)


def _drift(comm: MPI.Comm, particles: Particles, axis: int, edges: Sequence[float], signs: Sequence[Part]) -> bool:
    """Whether charges of both signs in a bin drift against each other so that the current counts. Collective."""
    present = comm.allreduce(np.array([(particles.charge < 0).any(), (particles.charge > 0).any()]).astype(int))
    if not present.all():
        return False
    flows = [flow(comm, part, axis) for part in _parts(particles, axis, edges, signs)]
    relative_speed = abs(math.tanh(math.asinh(flows[0].momentum(axis)) - math.asinh(flows[1].momentum(axis))))
    few, many = sorted(one.charge for one in flows)
    return relative_speed**2 > STATIC and few * relative_speed > FEW * (few + many)


def _range(comm: MPI.Comm, values: np.ndarray) -> np.ndarray:
    """Return the least and the largest value (2,) on all ranks. Collective."""
    bounds = np.array([-values.min(initial=np.inf), values.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, MPI.MAX)
    return bounds * (-1.0, 1.0)


# ---- what is left ----


def error_of(motion: Left, frame: Frame) -> np.ndarray:
    """Return about how much of the force of a part on itself is wrong (2,): by motion across, and by motion along the axis.

    A current is left without its magnetic field: that is its mean velocity times that of the charge along the axis. Without a
    current, charge that flies freely and not equally along all axes has another field than at rest. In a fast frame, motion
    across counts even if it is isotropic: particles are not seen at one time of the frame, but the later the further behind.
    """
    along, across = motion.square[frame.axis], np.delete(motion.square, frame.axis)
    isotropic, later = across.min(), max(map(abs, frame.beta)) ** 2
    free = (
        across.max() - (1 - later) * min(isotropic, along),
        max(along - motion.current[frame.axis] - (1 - later) * isotropic, 0.0),
    )
    parts = [FREE * square / (1 - square) for square in free]
    flows = motion.current.sum()
    parts[1] += max(flows, math.sqrt(along * flows))
    return np.array(parts)


def _errors(comm: MPI.Comm, particles: Particles, frames: Frames, flows: Sequence[Flow]) -> Frames:
    """Return the frames with the errors that are left, where they are largest: in the frame of one of the parts. Collective."""
    parts = frames.parts(_some(comm, particles))
    errors = np.array(
        [error_of(left(comm, part, frame), frame) for part, frame in zip(parts, frames.members, strict=True)]
    )
    charge = np.array([flow.charge for flow in flows])
    rapidity = np.array([math.asinh(flow.momentum(frames.axis)) for flow in flows])
    total = _seen(charge, rapidity) @ errors
    worst = total[int(np.argmax(total.sum(axis=1)))]
    return replace(frames, error=float(worst.sum()), across=float(worst[0]))


def _some(comm: MPI.Comm, particles: Particles) -> Particles:
    """Return as many particles as a mean over them needs, the same on any ranks. Collective."""
    all_charge = (
        1 << max(particles.global_count(comm) // SAMPLE, 1).bit_length() - 1
    )  # masks take a third of what remainders do
    return particles if all_charge == 1 else particles.select(np.flatnonzero(particles.id & (all_charge - 1) == 0))


def _seen(charge: np.ndarray, rapidity: np.ndarray) -> np.ndarray:
    """Return the shares (c, a) of charge a (C, in the laboratory) in the frame of c, where it is Q cosh(y_c - y) / cosh(y)."""
    amounts = np.cosh(rapidity[:, None] - rapidity) * (charge / np.cosh(rapidity))
    total = amounts.sum(axis=1, keepdims=True)
    return np.divide(amounts, total, out=np.zeros_like(amounts), where=total > 0)


def _kept(frames: Frames, last: Frames) -> Frames:
    """Return the frames, in place of each that has hardly changed the one of the step before."""
    if len(frames.members) != len(last.members):
        return frames
    members = tuple(
        old if new.axis == old.axis and abs(new.momentum - old.momentum) <= SAME * abs(new.momentum) else new
        for new, old in zip(frames.members, last.members, strict=True)
    )
    return replace(frames, members=members)

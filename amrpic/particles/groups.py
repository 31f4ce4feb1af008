"""Groups of particles that are measured by themselves: all, each species, each bunch."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .species import Species, SpeciesTable


@dataclass(frozen=True)
class NamedBunches:
    """Bunches of one kind, made one after the other: their name, how many they are, and macroparticles of each."""

    name: str
    copies: int
    number: int  # 0: known only from a file


@dataclass(frozen=True)
class Groups:
    """Unions of runs of ids. The same on all ranks.

    Ids from `starts[r]` to `starts[r + 1] - 1` are run r, of the species `species[r]`; `members[g]` are the runs of group g.
    """

    starts: tuple[int, ...]
    species: tuple[Species, ...]
    names: tuple[str, ...]  # no two the same
    members: tuple[frozenset[int], ...]

    @classmethod
    def of(cls, table: SpeciesTable, bunches: Sequence[NamedBunches] = ()) -> Groups:
        """Return all particles, each species, and each bunch as groups; of equal bunches in a row each one by itself.

        `bunches` are those that the table was made for; others leave the bunches of the table without names.
        """
        if not _fit(table, bunches):
            bunches = [NamedBunches("", 1, 0)] * len(table.starts)
        starts, species, names = [], [], []
        for start, member, bunch, index in zip(table.starts, table.members, bunches, range(len(bunches)), strict=True):
            name = bunch.name or f"bunch_{index}"
            for copy in range(bunch.copies):
                starts.append(start + copy * bunch.number)
                species.append(table.kinds[member])
                names.append(name if bunch.copies == 1 else f"{name}_{copy}")
        kinds = zip(table.names, table.kinds, strict=True)
        groups = [
            ("all", frozenset(range(len(starts)))),
            *(
                (name, frozenset(r for r, species_of_run in enumerate(species) if species_of_run == kind))
                for name, kind in kinds
            ),
            *((name, frozenset([run])) for run, name in enumerate(names)),
        ]
        return cls(
            tuple(starts),
            tuple(species),
            _distinct([_plain(name) for name, _ in groups]),
            tuple(members for _, members in groups),
        )

    @classmethod
    def of_species(cls, table: SpeciesTable) -> Groups:
        """Return all particles and each species as groups."""
        whole = cls.of(table)
        count = 1 + len(table.kinds)
        return cls(whole.starts, whole.species, whole.names[:count], whole.members[:count])

    def named(self, name: str) -> Groups:
        """Return the group of a name alone; KeyError if there is none."""
        if name not in self.names:
            raise KeyError(name)
        return Groups(self.starts, self.species, (name,), (self.members[self.names.index(name)],))

    def only(self, members: Sequence[frozenset[int]]) -> Groups:
        """Return the groups that have one of these members."""
        chosen = [(name, own) for name, own in zip(self.names, self.members, strict=True) if own in members]
        return Groups(self.starts, self.species, tuple(name for name, _ in chosen), tuple(own for _, own in chosen))

    @property
    def distinct(self) -> list[frozenset[int]]:
        """The members of groups, those of several equal groups once."""
        return list(dict.fromkeys(self.members))

    def run_of(self, ids: np.ndarray) -> np.ndarray:
        """Return the run of each id."""
        return np.searchsorted(self.starts, ids, side="right") - 1


def layers(sets: Sequence[frozenset[int]]) -> list[list[frozenset[int]]]:
    """Return the sets in as few lists as their order allows, no two sets of a list with a member in common."""
    out: list[list[frozenset[int]]] = []
    for members in sets:
        free = next((layer for layer in out if all(members.isdisjoint(members_there) for members_there in layer)), None)
        if free is None:
            out.append([members])
        else:
            free.append(members)
    return out


def _fit(table: SpeciesTable, bunches: Sequence[NamedBunches]) -> bool:
    if len(bunches) != len(table.starts):
        return False
    lengths = np.diff(table.starts)
    return all(
        bunch.copies == 1 or bunch.copies * bunch.number == length
        for bunch, length in zip(bunches[:-1], lengths, strict=True)
    )


def _plain(name: str) -> str:
    """Return a name without what has a meaning in tables of text."""
    return re.sub(r"[^\w.+-]", "_", name)


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, with a number behind those that came before."""
    out: list[str] = []
    for name in names:
        number, free = 2, name
        while free in out:
            free, number = f"{name}_{number}", number + 1
        out.append(free)
    return tuple(out)

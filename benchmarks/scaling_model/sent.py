"""What a rank sends by a call, and to whom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from amrpic.parallel import Traffic


@dataclass(frozen=True)
class Sent:
    """What a rank sends by one call, and how many of the bytes to each other rank; what is not in `to` goes to any."""

    traffic: Traffic
    to: Mapping[int, float] = field(default_factory=dict)

    def times(self, factor: float) -> Sent:
        """Return the same with so many times the bytes."""
        traffic = replace(self.traffic, bytes=round(self.traffic.bytes * factor))
        return Sent(traffic, {rank: size * factor for rank, size in self.to.items()})

    def __add__(self, other: Sent) -> Sent:
        to = {rank: self.to.get(rank, 0.0) + other.to.get(rank, 0.0) for rank in {*self.to, *other.to}}
        return Sent(self.traffic + other.traffic, to)

    def __sub__(self, other: Sent) -> Sent:
        to = {rank: size - other.to.get(rank, 0.0) for rank, size in self.to.items()}
        return Sent(self.traffic - other.traffic, to)

    def leaving(self, rank: int, ranks_per_node: int) -> float:
        """Return the bytes that leave the node of the rank that sends."""
        node = rank // ranks_per_node
        return max(self.traffic.bytes - sum(size for to, size in self.to.items() if to // ranks_per_node == node), 0.0)

"""What a machine takes for the work of the stages and for messages: constants of the model, kept in TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

from amrpic.errors import InputError

FOLDER = Path(__file__).parent / "machines"


@dataclass(frozen=True)
class Work:
    """Seconds of a stage: once per step, and for each of what is named.

    `cell`, `particle` and `brick`, one with particles, are of a rank. `spilled` is a cell for which the cache has no room;
    `cycle` and `cycle_spilled` are the same in a cycle, and `cycle_face` is a cell on the face of a box. `moved` is a particle
    that comes into another brick, `patch` one of ghosts behind open walls, `interaction` one of a patch with a node that holds
    charge, `near` with a leaf, and `byte` one that a rank sends, for its packing and unpacking.
    """

    call: float = 0.0
    cell: float = 0.0
    spilled: float = 0.0
    cycle: float = 0.0
    cycle_spilled: float = 0.0
    cycle_face: float = 0.0
    particle: float = 0.0
    moved: float = 0.0
    brick: float = 0.0
    patch: float = 0.0
    interaction: float = 0.0
    near: float = 0.0
    byte: float = 0.0


@dataclass(frozen=True)
class Network:
    """What messages between nodes take; of one node, what they take within it."""

    latency: float  # s per message
    bandwidth: float  # B/s of a node, which its ranks share
    ranks_per_node: int
    collective: float  # s per doubling of the ranks


@dataclass(frozen=True)
class Machine:
    """Constants of a machine. `alone` are those of `stages` on one rank, which has the node's memory for itself."""

    name: str
    source: str  # where the constants come from
    network: Network
    stages: Mapping[str, Work]
    alone: Mapping[str, Work]
    cache: float = 0.0  # bytes of a node's last level of cache, which its ranks share; 0 where no constant needs it

    def work(self, ranks: int) -> Mapping[str, Work]:
        """Return the constants of the stages for runs on so many ranks."""
        return self.alone if ranks == 1 and self.alone else self.stages

    def scaled(self, what: str, factor: float) -> Machine:
        """Return the machine with a constant of the network, or "work" for all those of stages, times a factor."""
        if what != "work":
            return replace(self, network=replace(self.network, **{what: getattr(self.network, what) * factor}))
        stages = {n: Work(*(factor * value for value in asdict(w).values())) for n, w in self.stages.items()}
        return replace(self, stages=stages, alone={})

    def write(self, path: Path) -> None:
        """Write the constants as TOML."""
        head = [
            f'name = "{self.name}"',
            f'source = "{self.source}"',
            *([f"cache = {self.cache:.0f}"] if self.cache else []),
        ]
        lines = [*head, "", *_section("network", asdict(self.network))]
        for prefix, group in ("stages", self.stages), ("alone", self.alone):
            for name, work in group.items():
                lines += ["", *_section(f'{prefix}."{name}"', {k: v for k, v in asdict(work).items() if v})]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    @classmethod
    def read(cls, name: str) -> Self:
        """Return a machine by the name of one that comes with the package, or by the path of its TOML. Raises InputError."""
        path = FOLDER / f"{name}.toml" if (FOLDER / f"{name}.toml").exists() else Path(name)
        try:
            values: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            stages, alone = (
                {key: Work(**of) for key, of in values.get(group, {}).items()} for group in ("stages", "alone")
            )
            network, cache = Network(**values["network"]), float(values.get("cache", 0))
            return cls(values["name"], values["source"], network, stages, alone, cache)
        except OSError as reason:
            known = ", ".join(sorted(file.stem for file in FOLDER.glob("*.toml")))
            raise InputError(
                f"machine {name} cannot be read ({reason.strerror}); give a TOML file, or one of {known}"
            ) from None
        except (ValueError, TypeError, KeyError) as reason:
            wanted = ", ".join(field.name for field in fields(Network))
            raise InputError(
                f"{path} describes no machine ({reason}); give name, source, [network] with {wanted}, and [stages.<stage>]"
            ) from None


def _section(name: str, values: Mapping[str, Any]) -> list[str]:
    return [f"[{name}]", *(f"{key} = {value:.4g}" for key, value in values.items())]

"""The part of the scene that says where finer levels lie, and when they follow the particles."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from .refinement_rules import ChargeDensityRule, RuleCombination, RuleKind, StaticRule, every_rule
from .section import Section


class Refinement(Section):
    """Where finer levels lie and how they are cut into boxes."""

    levels: int = Field(
        default=0, ge=0, le=20, description="Refined levels above the base, each of half the cell width."
    )
    max_grid_size: int = Field(
        default=32,
        ge=2,
        description="Most cells of a box along an axis, and one more where a single layer of cells would be left at the "
        "domain's upper face: small boxes balance the ranks, large ones are faster.",
    )
    blocking_factor: int = Field(
        default=8,
        ge=2,
        description="Boxes begin at multiples of it, and end there or at the domain's upper face, where the last one may "
        "be shorter; a power of two, so that they coarsen.",
    )
    rule: RuleKind = Field(
        default=ChargeDensityRule(relative=1e-3),
        description="What is refined. The default follows a Gaussian bunch out to 3.7 σ.",
    )
    hysteresis: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="Part of its thresholds down to which the rule keeps what is refined already (for at_most, the "
        "multiple up to 1 over it), so that the mesh does not flicker with the noise of the particles; 1: none.",
    )
    regrid_every: int = Field(default=5, ge=0, description="Steps between regrids; 0: not by the number of steps.")
    regrid_outrun: float | None = Field(
        default=None,
        ge=0,
        lt=1,
        description="Regrid in any step in which more than this part of the particles lies in cells that the rule wants "
        "finer than they are: particles that have outrun their level. With 0, and regrid_every = 0, exactly when needed. "
        "Costs a look at the tags in each step; potential and field are then those of the step before.",
    )
    buffer: int = Field(
        default=2,
        ge=0,
        description="Cells around tagged ones that are refined too: 2 keep dense charge 4 fine cells off the faces.",
    )
    efficiency: float = Field(default=0.7, gt=0, le=1, description="Least part of a clustered box that is tagged.")
    nesting: int = Field(default=2, ge=1, description="Least cells of a level around the next finer one.")

    @model_validator(mode="after")
    def _sizes(self) -> Self:
        block, size = self.blocking_factor, self.max_grid_size
        if block & (block - 1):
            below = 2 ** (block.bit_length() - 1)
            self.refuse("blocking_factor", "is not a power of two", f"use {below} or {2 * below}")
        if size % block:
            near = f"{size // block * block} or {(size // block + 1) * block}" if size > block else f"{block}"
            self.refuse("max_grid_size", f"is not a multiple of the blocking factor {block}", f"use {near}")
        return self

    @model_validator(mode="after")
    def _levels_exist(self) -> Self:
        for path, rule in every_rule(self.rule):
            if isinstance(rule, StaticRule):
                for index, box in enumerate(rule.boxes):
                    if box.level > self.levels:
                        self.refuse(
                            f"{path}.boxes.{index}.level",
                            f"lies above the {self.levels} refined levels of the scene",
                            f"set refinement.levels to {box.level} or more, or leave the box out",
                        )
            elif rule.levels is not None and max(rule.levels) >= self.levels:
                self.refuse(
                    f"{path}.levels",
                    f"names a level whose cells nothing refines: the scene has {self.levels} refined levels",
                    f"name levels below {self.levels}, or set refinement.levels to {max(rule.levels) + 1} or more",
                )
        return self

    @model_validator(mode="after")
    def _something_to_outrun(self) -> Self:
        if self.regrid_outrun is not None and not self.follows:
            self.refuse(
                "regrid_outrun",
                "has no meaning for a mesh that never changes",
                "leave it out, or choose a rule other than static, and levels of 1 or more",
            )
        return self

    @property
    def follows(self) -> bool:
        """Whether the mesh can follow the particles: it is refined, and not by static boxes alone."""
        parts = [rule for _, rule in every_rule(self.rule) if not isinstance(rule, RuleCombination)]
        return self.levels > 0 and not all(isinstance(rule, StaticRule) for rule in parts)

    def regrids_at(self, step: int) -> bool:
        """Whether the mesh follows the particles in this step, whatever they do."""
        return self.follows and self.regrid_every > 0 and step % self.regrid_every == 0

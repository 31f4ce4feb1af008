"""Whether the parts of a scene fit together: each complaint names the key, the value found and what to do."""

from __future__ import annotations

import math

from ..mesh.domain import AXES, FACES
from .bunches import DescribedBunch
from .complaints import close_match
from .domain_section import LARGEST_INDEX
from .elements import ConstantFocusingElement
from .injection import InjectionSource
from .obstacles import aperture_names, repeated_names
from .parts import SceneParts
from .refinement_rules import EmissionRule, RuleOfElectrodes, StaticBox, StaticRule, every_rule
from .sources import Source, WallSource

MOST_BINS = 1_000_000  # of a map of losses
MOST_BLOCKS = 2**20  # of a level along an axis: `native/mesh/hierarchy.cpp`
FINEST = 1e-14  # of a place: how wide cells of the finest level are at least, some tens of roundings
LARGEST_ROW = 2**63 - 1  # rows of the equations are counted in 64 bits over all ranks


def check(scene: SceneParts) -> None:
    """Raise the first complaint about parts of a scene that do not fit together."""
    for fits in (
        _name,
        _cells,
        _boxes,
        _conductors,
        _places,
        _balance,
        _stretch,
        _screening,
        _electrodes,
        _elements,
        _window,
        _names,
        _sources,
        _emission_rule,
        _bins,
    ):
        fits(scene)


def _name(scene: SceneParts) -> None:
    if "/" in scene.name or scene.name in (".", ".."):
        scene.refuse("name", "is a path", "give a plain name, and the folder as output.directory")


def _cells(scene: SceneParts) -> None:
    cells, levels = scene.domain.cells, scene.refinement.levels
    blocks = MOST_BLOCKS * scene.refinement.blocking_factor
    if max(cells) * 2**levels > blocks and max(cells) <= blocks < LARGEST_INDEX:
        scene.refuse(
            "refinement.levels",
            f"makes more than 2^20 blocks of {scene.refinement.blocking_factor} cells along {AXES[cells.index(max(cells))]}",
            f"use {int(math.log2(blocks / max(cells)))} levels at most, or fewer base cells",
        )
    for axis, number in enumerate(cells):
        width = (scene.domain.upper[axis] - scene.domain.lower[axis]) / number / 2**levels
        farthest = max(abs(scene.domain.lower[axis]), abs(scene.domain.upper[axis]))
        if width < FINEST * farthest:
            scene.refuse(
                "refinement.levels",
                f"makes cells of {width:.3g} m at {AXES[axis]} = {farthest:g} m, too fine for places of 64 bits",
                "use fewer levels, or move the domain nearer to 0",
            )
        if number * 2**levels > LARGEST_INDEX:
            scene.refuse(
                f"domain.cells.{axis}",
                f"makes {number * 2**levels} cells on the finest level, more than 32 bits count",
                "use fewer base cells or levels",
            )
    if (rows := int(cells[0]) * int(cells[1]) * int(cells[2])) > LARGEST_ROW:
        scene.refuse(
            "domain.cells",
            f"makes {rows} equations, more than the {LARGEST_ROW} that 64-bit row numbers count",
            "use fewer base cells",
        )


def _boxes(scene: SceneParts) -> None:
    for path, rule in every_rule(scene.refinement.rule, "refinement.rule"):
        for number, box in enumerate(rule.boxes if isinstance(rule, StaticRule) else ()):
            _box(scene, box, f"{path}.boxes.{number}")


def _box(scene: SceneParts, box: StaticBox, path: str) -> None:
    for axis in range(3):
        last = scene.domain.cells[axis] * 2**box.level - 1
        outside = box.first and box.last and (box.first[axis] < 0 or box.last[axis] > last)
        if outside and not scene.domain.value.periodic[axis]:
            scene.refuse(
                path,
                f"leaves the domain, whose cells of level {box.level} reach from 0 to {last} along {AXES[axis]}",
                "move it inside",
                found=[box.first, box.last],
            )


def _conductors(scene: SceneParts) -> None:
    names = [conductor.name for conductor in scene.conductors]
    for path, rule in every_rule(scene.refinement.rule, "refinement.rule"):
        if not isinstance(rule, RuleOfElectrodes):
            continue
        if not names:
            scene.refuse(
                f"{path}.kind", "refines at electrodes, of which the scene has none", "add some, or use another rule"
            )
        for number, name in enumerate(rule.electrodes or ()):
            if name not in names:
                scene.refuse(f"{path}.electrodes.{number}", "names no electrode", close_match(name, names))


def _places(scene: SceneParts) -> None:
    for number, bunch in enumerate(scene.bunches):
        for place in bunch.places():
            for axis in range(3):
                inside = scene.domain.lower[axis] <= place[axis] <= scene.domain.upper[axis]
                if not (inside or scene.domain.value.periodic[axis]):
                    scene.refuse(
                        f"bunches.{number}.centre",
                        f"puts a bunch outside the domain, at {AXES[axis]} = {place[axis]:g} m where it reaches "
                        f"from {scene.domain.lower[axis]:g} to {scene.domain.upper[axis]:g} m",
                        "move the bunch or enlarge the domain",
                        found=list(place),
                    )


def _balance(scene: SceneParts) -> None:
    singular = scene.fixes_no_potential
    if scene.background == "neutralizing" and not singular:
        scene.refuse(
            "background",
            "needs a domain whose faces are all periodic or neumann, no screening, and no electrode at a voltage",
            "change domain.boundary or solver.screening, or leave the background out",
        )
    charges = [bunch.bunch_charge * bunch.copies for bunch in scene.bunches]
    scale = sum(abs(charge) for charge in charges)
    if singular and not scene.domain.slope and scene.background == "none" and abs(sum(charges)) > 1e-12 * scale:
        scene.refuse(
            "background",
            f"has no solution: all faces are periodic or neumann, and the net charge is {sum(charges):g} C",
            'set background = "neutralizing", or charges that add up to zero',
        )


def _stretch(scene: SceneParts) -> None:
    if scene.motion.follows_fields and scene.solver.stretch != (1.0, 1.0, 1.0):
        scene.refuse(
            "solver.stretch",
            "is for bunches at rest in the scene; the leapfrog finds that of a moving one by itself",
            "leave stretch out, and set motion.frame",
        )


def _screening(scene: SceneParts) -> None:
    if refused := scene.solver.screening_refusal(scene.domain.value):
        scene.refuse("solver.screening", *refused)


def _electrodes(scene: SceneParts) -> None:
    if not scene.conductors:
        return
    if scene.solver.order != 2:
        scene.refuse("solver.order", "does not know electrodes", "set it to 2")
    if scene.domain.value.singular and scene.fixes_no_potential:
        scene.refuse(
            "electrodes",
            "float all between periodic and neumann faces, so that nothing fixes the potential",
            "give one of them a voltage, or a face one",
            found="",
        )


def _elements(scene: SceneParts) -> None:
    for number, element in enumerate(scene.elements):
        if not isinstance(element, ConstantFocusingElement) or element.wavenumber is None:
            continue
        first = scene.bunches[0] if scene.bunches else None
        if not isinstance(first, DescribedBunch) or not any(first.mean_momentum) or first.species.charge == 0:
            scene.refuse(
                f"elements.{number}.wavenumber",
                "needs a first bunch whose species is charged and whose mean momentum is not zero, both in the scene",
                "give it one, or the element a gradient",
            )


def _window(scene: SceneParts) -> None:
    if scene.motion.window == "none":
        return
    reference = scene.reference
    if reference is None or not any(reference.mean_momentum):
        scene.refuse(
            "motion.window",
            "needs a reference particle that moves",
            "give motion.reference a momentum, or the first bunch one in the scene",
        )
    axis = scene.axis_of_wall_left
    if axis is not None:
        _wall_behind(scene, AXES[axis], 1 if reference.mean_momentum[axis] > 0 else 0)
    for kind, per_face in (("potential", scene.domain.potential), ("slope", scene.domain.slope)):
        for name, pair in per_face.items():
            if axis is not None and any(pair):
                scene.refuse(
                    f"domain.{kind}.{name}",
                    "has an image in the wall that the window leaves behind, which is not known",
                    f"give the field as an element, or make the faces of {AXES[axis]} open",
                )
            if any(isinstance(value, str) for value in pair):
                scene.refuse(
                    f"domain.{kind}.{name}",
                    "is a formula, which the window would take along",
                    "give numbers, or the field as an element",
                )


def _wall_behind(scene: SceneParts, axis: str, ahead: int) -> None:
    """Raise a complaint if there is a wall ahead of the window: a plane behind it mirrors from where it stays."""
    faces = scene.domain.boundary[axis]
    if faces[ahead] != "open":
        scene.refuse(
            f"domain.boundary.{axis}",
            "has a wall ahead of the window, which would take it along",
            f"make the {('lower', 'upper')[ahead]} face open; a wall behind the window may stay, and is left there",
        )


def _names(scene: SceneParts) -> None:
    screens = [screen.name for screen in scene.screens]
    apertures, sources = aperture_names(scene.apertures), [source.name for source in scene.sources if source.name]
    electrodes = [electrode.name for electrode in scene.electrodes]
    for key, names, reserved in (
        ("apertures", apertures, FACES),
        ("electrodes", electrodes, (*FACES, *apertures)),
        ("screens", screens, ()),
        ("sources", sources, ()),
    ):
        for number, name in repeated_names(names, reserved):
            has_it = "a face of the domain" if name in FACES else f"one of the {key} before it"
            has_it = "an aperture" if key == "electrodes" and name in apertures else has_it
            scene.refuse(
                f"{key}.{number}.name", f"is the name of {has_it} already", "give each one of its own", found=name
            )


def _sources(scene: SceneParts) -> None:
    if scene.sources and not scene.motion.follows_fields:
        scene.refuse(
            "sources",
            f'have particles that move, and motion.kind is "{scene.motion.kind}"',
            'set motion.kind to "leapfrog"',
            found="",
        )
    for number, source in enumerate(scene.sources):
        if isinstance(source, Source) and source.electrode is not None:
            _on_electrode(scene, source, f"sources.{number}")
            continue
        face = source.face_number
        kind = None if face is None else scene.domain.value.boundary[face // 2][face % 2]
        if (isinstance(source, WallSource) or source.is_limited) and kind != "dirichlet":
            scene.refuse(
                f"sources.{number}.face",
                f"is {kind}, where the field at it does not decide on what is emitted",
                'make that face of domain.boundary dirichlet, or give the charge of the source (process = "given")',
            )
        if kind == "dirichlet" and scene.solver.order != 2:
            scene.refuse(
                "solver.order",
                f"is {scene.solver.order}, and the field at walls that emit is known for 2 alone",
                "set it to 2",
            )


def _on_electrode(scene: SceneParts, source: Source, path: str) -> None:
    """Raise a complaint if a source is on an electrode that cannot emit."""
    names = [electrode.name for electrode in scene.electrodes]
    if source.electrode not in names:
        scene.refuse(f"{path}.electrode", "names no electrode", close_match(str(source.electrode), names))
    if isinstance(source, InjectionSource):
        scene.refuse(f"{path}.electrode", "injects no beam from elsewhere", "give a face or a plane")
    if scene.motion.window != "none":
        scene.refuse(
            f"{path}.electrode",
            "emits where a window would leave it, which electrodes do not",
            'set motion.window to "none"',
        )


def _emission_rule(scene: SceneParts) -> None:
    emits = any(source.face is not None for source in scene.sources)
    for path, rule in every_rule(scene.refinement.rule):
        if isinstance(rule, EmissionRule) and not emits:
            scene.refuse(
                f"refinement.{path}",
                "refines at faces that sources emit from, and none does",
                "name a face of [[sources]], or choose another rule",
                found=rule.kind,
            )


def _bins(scene: SceneParts) -> None:
    length, width = scene.domain.upper[2] - scene.domain.lower[2], scene.diagnostics.loss_bin
    if width is not None and length > MOST_BINS * width:
        scene.refuse(
            "diagnostics.loss_bin",
            f"makes more than {MOST_BINS} bins of a domain {length:g} m long",
            "give a longer one",
        )

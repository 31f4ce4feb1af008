"""Write docs/reports/performance.md and its pictures from what `make bench` measured.

Run it by `python benchmarks performance BENCH.json`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import bases
import charts
import gamma
import goals
import growth
from cases import FAMILIES
from goals import markdown
from measuring import ROOT, Record, figure, read, share_of_core
from particles import STAGES
from peers import peer_name
from reference import MLMG, MLMG_CYCLES
from reference import PARTICLES as REFERENCE
from solving import BOXES, FULL, IN_TURNS, name

PICTURES = "performance_"  # what their files begin with
APPLY_BYTES = 24  # per cell, of the work unit: a value read, and a value written to a line that was fetched


def document(records: Sequence[Record], about: dict[str, Any]) -> str:
    """Return the whole text, figures and prose."""
    machine = about["machine"]
    return TEXT.format(
        processor=machine["processor"],
        instructions=machine["instructions"],
        cores=machine["cores"],
        core=share_of_core(records),
        time=machine["time"],
        commit=machine["commit"],
        runs=about["runs"],
        backend=about["backend"],
        goals=markdown(goals.table(goals.goals(records))),
        units=markdown(units(records)),
        solves=markdown(solves(records)),
        ranks=markdown(ranks(records)),
        uniform=markdown(uniform(records)),
        bases=markdown(bases.rows({record.name: record for record in records})),
        gamma=markdown(gamma.rows({record.name: record for record in records})),
        steps=markdown(steps(records)),
        particles=markdown(particles(records)),
        memory=markdown(memory(records)),
        growth=markdown(growth.rows(growth.laws(records))),
        apply_bytes=APPLY_BYTES,
    )


def units(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return the work units of one rank by number of cells, with the two times that each is the less of."""
    rows: list[tuple[str, ...]] = [
        (
            "cells",
            "plain apply, per cell",
            f"{APPLY_BYTES} bytes at a triad's bandwidth",
            "triad",
            "work unit, per cell",
        )
    ]
    mine = {record.cells: record for record in records if record.unit and record.cells and ", 1 rank, " in record.name}
    for cells in spread(sorted(mine), 7):
        record = mine[cells]
        per_cell = (record.apply / cells, APPLY_BYTES / record.triad if record.triad else math.nan, record.unit / cells)
        apply, memory, unit = (f"{1e9 * seconds:.2f} ns" for seconds in per_cell)
        rows.append((f"{cells:,}".replace(",", " "), apply, memory, f"{record.triad / 1e9:.1f} GB/s", unit))
    return rows


def spread(values: Sequence[int], count: int) -> list[int]:
    """Return at most so many of sorted values, the first and the last among them."""
    if len(values) <= count:
        return list(values)
    return [values[round(at * (len(values) - 1) / (count - 1))] for at in range(count)]


def solves(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return the solves on one rank: time, work units and cycles, what a cycle takes, and AMReX's beside them."""
    rows: list[tuple[str, ...]] = [
        (
            "case",
            "boxes",
            "cells",
            "1e-10",
            "WU",
            "over the DST",
            "cycles",
            "WU per cycle",
            "to 1e-6, WU",
            "to discretization, WU",
            "AMReX, WU",
        )
    ]
    known = goals.Found(records)
    for case in (f"{family} {n}" for family in FAMILIES for n in (64, 128)):
        for boxes in BOXES:
            record = known.records.get(name(case, boxes, 1))
            if record is None:
                continue
            cycles = record.facts["cycles"]
            more = (in_units(known.records.get(name(case, boxes, 1, what))) for what in ("1e-06", "discretization"))
            reference = MLMG.get((case, boxes))
            cells = f"{record.cells / 1e6:.2f} M"
            units = (in_units(record), number(record.over_dst, "×"))
            first = (case, str(boxes), cells, f"{record.median:.3g} s", *units, str(cycles))
            rows.append((*first, in_units(record, cycles), *more, number(reference or math.nan)))
    return rows


def ranks(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return the solves to 1e-10 on two ranks against one."""
    rows: list[tuple[str, ...]] = [("case", "boxes", "1 rank", "2 ranks", "faster")]
    known = goals.Found(records)
    wanted = [("static 128", 32, IN_TURNS)]
    wanted += [(f"{family} {n}", boxes, f"{FULL:g}") for family in FAMILIES for n in (64, 128) for boxes in BOXES]
    for case, boxes, what in wanted:
        names = [name(case, boxes, count, what) for count in (1, 2)]
        one, two = map(known.seconds, names)
        in_turns = what == IN_TURNS
        if not math.isnan(one + two):
            faster = known.ratio(*names) if in_turns else one / two
            rows.append(
                (
                    f"{case}, in turns" if in_turns else case,
                    str(boxes),
                    f"{one:.3g} s",
                    f"{two:.3g} s",
                    f"{faster:.2f}×",
                )
            )
    return rows


def uniform(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return all solvers on the uniform meshes, set-up and iterations too."""
    rows: list[tuple[str, ...]] = [("mesh", "solver", "set-up", "to 1e-10", "WU", "iterations")]
    known = {record.name: record for record in records}
    for n in (64, 128):
        beginning = peer_name(n, "")
        mine = [r for r in records if r.name.startswith(beginning) and not r.name.endswith("set-up")]
        for record in sorted(mine, key=lambda record: record.median):
            setup = known.get(f"{record.name}, set-up")
            before = f"{setup.median:.3g} s" if setup is not None else ""
            iterations = str(record.facts.get("iterations", ""))
            who = record.name.removeprefix(beginning)
            rows.append((f"{n}³", who, before, f"{record.median:.3g} s", in_units(record), iterations))
        reference, ours = MLMG.get((f"uniform {n}", 64)), known.get(peer_name(n, "amrpic"))
        if reference is not None and ours is not None:
            scaled = f"{reference * ours.unit:.3g} s"
            rows.append((f"{n}³", "AMReX MLMG, another run, scaled", "", scaled, number(reference), "10"))
    return rows


def particles(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return the particle stages in ns per particle, by number and shape."""
    rows: list[tuple[str, ...]] = [("particles", "shape", *STAGES)]
    mine = {record.keys: record for record in records if record.keys[0] == "particles"}
    for count, shape in sorted({keys[2:] for keys in mine}):
        found = (mine["particles", stage, count, shape] for stage in STAGES)
        rows.append((count, shape, *(f"{1e9 * record.median / record.particles:.1f} ns" for record in found)))
    rows.append(("1e+07", "AMReX, cloud-in-cell", *(number(REFERENCE.get(stage, math.nan), " ns") for stage in STAGES)))
    return rows


def memory(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return the memory of the solver per cell, and of particles."""
    rows: list[tuple[str, ...]] = [("what", "bytes")]
    for record in records:
        if record.keys[0] == "memory":
            for what, value in record.facts.items():
                rows.append((f"{', '.join(record.keys[1:])}: {what.removeprefix('bytes ')}", figure(value)))
    return rows


def steps(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return whole steps, with the stages of ours."""
    rows: list[tuple[str, ...]] = [("step of", "time", "stages")]
    for record in records:
        if record.keys[0] == "step":
            stages = (f"{stage} {1e3 * spent:.3g} ms" for stage, spent in record.facts.get("stages", {}).items())
            rows.append((record.name.removeprefix("step, "), f"{record.median:.3g} s", ", ".join(stages)))
    return rows


def number(value: float, unit: str = "") -> str:
    return "–" if math.isnan(value) else figure(value) + unit


def in_units(record: Record | None, cycles: int = 1) -> str:
    """Return a median in work units, per cycle of so many."""
    return "–" if record is None or math.isnan(record.units) else figure(record.units / cycles)


TEXT = """# Performance

Made by `make bench` (`python benchmarks bench`), figures and pictures; commit {commit}, {time}, on {cores} cores of
{processor}, kernels for {instructions}, backend `{backend}`, of which a run on one rank had {core:.0%}. Figures are medians of
{runs} runs. Seconds belong to that machine and to what else it did; ratios and work units travel. `python benchmarks compare
OLD NEW` runs two builds in turns, and resolves differences of 3 %; `python benchmarks compare_records BEFORE.json
AFTER.json` compares two runs of this.

## Goals

{goals}

![Each figure over its goal](pictures/performance_goals.png)

## The roof: what memory gives

A **work unit** (WU) is the time of one plain 7-point apply, in double precision and vectorised, on one array with as many
cells as the hierarchy has; or, if that is less, the time that memory takes for the {apply_bytes} bytes per cell that such an
apply moves, at the bandwidth of a triad on arrays out of cache. It is what an explicit code pays to look at every cell
once, so a solver's time in WU says how many looks it takes. Both are measured beside every figure, the apply as the best of
five, the triad as the best of three, in CPU time, which does not count how long a rank waits where others use its core.

The {apply_bytes} bytes: an apply's neighbours come from the cache, so 8 bytes are read, and 16 move for the value that is
written, since an ordinary store fetches the line before it changes it. A triad, a = b + s c, moves 32 bytes per value,
counted equally; its three arrays take 144 MB. For the apply,

- rows start on cache lines and hold whole vectors, else most loads cross a line;
- tiles of 32 rows keep three planes in the second-level cache; without tiles, planes of 192² cells and more are read from
  further away up to three times, which gave 0.3 to 0.6 of a triad's bandwidth;
- arrays are written once before anything is timed, so that pages exist, and each trial's first pass is not counted.

**Why the bound.** Out of cache, an apply should take what its bytes take. On a Xeon with AVX-512 it reached 0.79 to 0.85 of
a triad's bandwidth: 15.5 of 18.8 GB/s on 17 and 34 million cells. A plain copy with one factor, which has the same two
streams, reached 17.5 GB/s; so half of the gap is the larger part of writes. The other half is prefetching: the hardware
loses its streams at the ends of rows and tiles, and software prefetch of one plane and one row ahead brought the apply to
17.8 GB/s. Non-temporal stores save the fetch in both (from 1.52 to 1.28 ns per cell of the apply, from 1.70 to 1.26 ns per
value of the triad) and leave the apply further behind; huge pages and other tiles gained nothing. On an AMD EPYC with Zen 4
cores the same apply reached 0.43 to 0.78 of a triad on the same footprint. There a third-level cache of high bandwidth
serves the triad, while an apply of one core issues seven loads per vector, two of which cross a line; this was not measured
further. An apply that loses its streams makes a long unit, and a solver look good; so the unit is never longer than memory
needs.

**What goals in WU mean.** Until commit 8e352b5 the unit was the apply alone, and a figure decided nothing where the apply
reached less than 0.8 of the bandwidth of a triad on the same footprint. Where it was valid in that sense and out of cache,
the present unit is 0.8 to 1 of the former one; in cache, where the apply is faster than memory, it is the former one. So
the goals of 80, 100 and 45 WU, which come from an AVX-512 machine where a unit took 0.65 to 1.1 ns per cell and a copy
moved 32 GB/s (0.75 ns per {apply_bytes} bytes), mean the same or up to a fifth less time, never more. AMReX's 420 to 730 WU
were measured in the former unit, at 0.82 to 0.90 ns per cell; in the present one they would be the same or up to a quarter
more.

{units}

While both arrays fit the last cache a work unit per cell can be half as long as beyond it: figures in WU of small and of
large cases are not to be compared with each other. Times over those of scipy's sine transform on 128³ cells, in the same
turn and per cell, can.

**What a cycle must move.** Per cell of the refinement levels, if every pass reads and writes memory once: the composite
residual reads φ and ρ and writes r in single precision (8 + 8 + 8 bytes), the sweeps before the coarse correction read r
and write the correction e (4 + 8), those after it read both and write e (4 + 4 + 4), and φ takes e in (8 + 8 + 4). That is
68 bytes, to which multigrid levels below the base add a seventh of the single-precision part where the base is most of the
mesh: about 70 bytes, or 3 WU per cycle. What is above that is arithmetic, cache traffic of the fused planes, ends of rows,
and coarse-fine faces.

## The design

One formula, two executions. The weights of the stencils are written once (`native/stencil`); they are executed as Tpetra's
sparse matrices (`backend="crs"`), which run on whatever Trilinos was built for and feed its algebra, and without matrices
(`backend="matrix-free"`). A sparse row takes 12 bytes for each of its entries, so one CRS apply costs as much as five to
fifteen plain ones, and no smoothing on matrices comes near the roof. What makes the matrix-free path fast, in the order of
what it brings:

1. **Few cycles.** Over-relaxed red-black Gauss-Seidel (ω = 1.2, on refined levels 1.28) in the exact global colour order, two
   sweeps before and two after the coarse correction, trilinear prolongation, from the base down an F-cycle: per cycle the
   residual falls to a three-hundredth on one level and to a sixtieth on nested ones, the same for every cutting into boxes
   and ranks. Colours frozen at box or rank borders, or reversed after the coarse correction, cost twice the cycles. Levels
   of long or flat cells are smoothed by a cycle of their own, over copies that are coarser along the short axes. Nested
   levels of like size take a V-cycle: an F-cycle over them would cost more than it saves.
2. **Single precision where it suffices.** φ, ρ and the composite residual are double; corrections are single, scaled level by
   level so that SI magnitudes do not underflow, inside a defect correction. Cycle counts are those of double precision, the
   traffic is half.
3. **Fused passes.** All half-sweeps of a level run in one pass, as a wavefront over planes: while a plane takes its first
   half-sweep, those behind it take their later ones, out of the second-level cache. Restriction is done at the tail of the
   pass before the coarse correction, prolongation at the head of the pass after it: two passes per level and cycle, the
   first of which starts from a zero that is never stored. Rows go in their own order, so that each comes once from the
   second-level cache; bands of rows that take several stages in the first one were tried, and gained nothing.
4. **Large blocks.** For the sweeps, boxes of a rank are joined to the largest blocks that they fill, rows padded to whole
   vectors, so that the size of boxes hardly matters. What lies beside a row is read from a table, neighbouring blocks by
   pointer; copies of cells, four deep so that one exchange serves a whole pass, exist at rank borders alone. They are on
   their way while planes are swept: what others copy takes the coarser correction first and is sent, and a pass waits
   where it reaches the halo. Small levels are held by every rank. Large arrays lie in huge pages.
5. **Interfaces as exceptions.** Coarse-fine faces are lists of rectangles beside the regular loops, and those of the
   composite residual are taken in double precision; the loops themselves know nothing of them.
6. **Nothing twice.** Set-up makes lists, no matrices; the coarsest level is solved exactly from its eigenvectors along each
   axis. Norms are taken where values are written; the first residual of a zero guess is made from the charge alone.

## Solves

From a zero guess on one rank. AMReX's column is its multigrid (MLMG 24.10, {cycles} cycles) measured on another day on two
cores with AVX-512, in the WU of that run. "Over the DST" is the time per cell over that of scipy's sine transform and its
inverse on 128³ cells in the same turn, which the goals of the first table in "×" of it go by, too, in eleven turns.

{solves}

![Work units to 1e-10](pictures/performance_solver.png)

Two ranks against one; "in turns" were measured in one run, one rank alone and both by turns, "faster" being the median of
their ratios; the others were measured minutes apart:

{ranks}

## Uniform mesh, next to peers

The same equations, from zero to 1e-10, each solution checked against the sine transform's: scipy's DST (`dstn` type 2 and
its inverse, one worker: direct, for boxes between grounded walls alone), hypre 2.26 (conjugate gradients around PFMG and
around BoomerAMG), pyamg (Ruge-Stüben around conjugate gradients), run in the same session. A peer that is not installed is
left out. Ours ends at 1e-10 in the max norm, the peers in the 2-norm.

{uniform}

![Solvers on the uniform mesh](pictures/performance_uniform.png)

## Bases of any extent

Time per cell of one level of n³ cells between grounded walls, to 1e-10, beside the nearest 2^k or 3·2^k in the same turns.

{bases}

## Long cells

A bunch that moves with γ is solved for on cells γ times as long. 64³ cells with one refined level of cells 8 to 119 along
each axis, or with three nested cubes of 64³ cells; beside the same mesh with γ = 1, in the same turns.

{gamma}

## Particles and whole steps

Particle stages on one core, 128³ cells in boxes of 32³; `migrate` after each particle has moved by 0.3 cell widths. A whole
step is that of a ball of 1e6 particles on 64³ cells with one refined level, cloud-in-cell, solved to 1e-7: ours from the
previous potential, with fluxes matched between the levels; ImpactX (`impactx-noacc`, sequential) level by level.

{particles}

These too wait for memory where there are few particles per cell. A deposit reads 24 bytes of each particle, since equal
weights take no memory, and moves 16 of each cell; with boxes of 32³, what clouds leave in the cells around boxes moves 14
more. Gather and push read 48 and write 48 bytes of each particle, and of each cell its potential and, with boxes of 32³, 9
bytes of what is kept of E. A migration reads 80 and writes 56 bytes. So 1e6 particles on 128³ cells move at least 87, 132 and
136 bytes each, 1e7 30, 100 and 136. What comes in long rows is asked for a page ahead, what comes in short ones a plane
ahead, into the second-level cache: in the first one it would displace the tile.

Momenta at the time of the field lie between those that are read and those that are written, and are not kept. The series
takes them from both (`moments`); a checkpoint, which a run goes on from in all digits, from another pass.

The electric field is not kept in all cells. Inside a box it is the difference of the potential across a cell, which is made as
the tile is filled: a third of what three components take is read. Only at the faces of boxes, and in boxes that a finer level
covers a part of, it is made beforehand (`field`), since it takes values of other boxes, walls and levels there. These cells lie
together, face by face, with their components side by side, so that what a tile takes from the boxes around it comes by whole
cache lines; in three arrays over all cells, a column would use a number in each of three lines per cell. The components are
written out where somebody asks for them: by dumps, checkpoints, tags by field, and in Python.

Particles are sorted by bricks of 8³ cells. What the particles of a brick touch of a tile stays in the first-level cache,
whatever their order, and few leave a brick in a step: 6 % at 0.3 cell widths. So a migration holds eight particles at a time
against a brick, and only those that left it are looked up. Then it is known where each brick will start, and the particles are
copied in the order that they have, some thousands at a time, one column after the other: those that stay by vectors, which are
joined to whole cache lines in registers, the movers one by one to the next free place of their brick, which a counting sort
tells. So particles of a brick keep their order, a run that was stopped goes on with the same, and nothing is sorted by
comparing. Of the time at 1e6, copying takes 60 %, assigning places to movers and asking for these 12 %, holding and looking up
the rest. A gather at half a particle per cell spends some 40 % of its time on filling the tile, which waits for memory.

Every step adds a row to the time series. Means, sizes, emittances, momentum and kinetic energy of the beam come from one
pass over the particles (`moments`), deviations being taken from the means so far; energies of the fields from one pass over
each. The tables of groups of particles cost more and come every 20 steps ([diagnostics.md](../diagnostics.md#what-it-costs)).

Nanoseconds belong to {processor}: on a Cascade Lake at 2.5 GHz deposit, gather and push, and migrate took 17, 31 and 27 ns at
1e6 where an AVX-512 machine with faster memory took 7, 12 and 13. So goals are ratios to plain loops in C
(`benchmarks/plain_particles.c`), one particle at a time, compiled for the same processor and in turns with ours in CPU time:
clouds in cells on one array over the mesh, a gather of three components with kick and drift, a counting sort of all columns by
bricks, two passes for the moments. Theirs know neither boxes, levels nor ranks.

![Particle stages](pictures/performance_particles.png)

{steps}

![Where the time goes](pictures/performance_stages.png)

## Memory

Of one rank, from its resident set: the solver beyond φ and ρ, once set up and at its peak until it has solved; particles as
a run holds them, and at the peak of a migration, with the old ones and the new.

{memory}

Each step makes arrays of about the sizes that the step before made, and a fresh page takes longer to come by than to fill.
So arrays of megabytes are kept for the next taker: as much as is in use, but never more than was in use at some time.

## More ranks

`amrpic scaling SCENE --ranks 1 2 4 8` measures steps of any scene on so many ranks, which it starts itself (on a cluster
with `--launcher "srun -n {{ranks}}"`): the scene as it is, and with cells and particles in proportion to the ranks. It
prints a table and writes `scaling.json` and `scaling.png`. Ranks need a core each: on fewer, what is measured is how long
they wait for each other.

## Growth

Power laws through medians: time ∝ size^exponent. Levels are nested cubes of 64³ cells each, so their time grows with the
cells that they bring; boxes cut one mesh of 64³ cells finer and finer; cells are those of `static` at bases of 32 to 128.
Particle stages pay for the 128³ cells that they pass over as well, which the time of few particles shows.

{growth}

![Growth of cost](pictures/performance_growth.png)
""".replace("{cycles}", str(MLMG_CYCLES))


def write(bench: Path, folder: Path) -> Path:
    """Write the document and its pictures into a folder, from the JSON of a run; return the document."""
    records = read(bench)
    about = json.loads(bench.read_text(encoding="utf-8"))
    charts.draw(records, folder / "pictures", PICTURES)
    out = folder / "performance.md"
    out.write_text(document(records, about), encoding="utf-8")
    return out


def run(
    bench: Annotated[Path, "bench.json of a run"],
    output: Annotated[Path, "folder of the document"] = ROOT / "docs" / "reports",
) -> None:
    """Write the document."""
    print(write(bench, output))

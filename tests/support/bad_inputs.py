"""Inputs that a run must refuse: keys, values and units of scenes, command lines, scene files, and files that scenes name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

SCENE = """
[domain]
lower = -0.1
upper = 0.1
cells = 16
boundary = "dirichlet"

[[bunches]]
distribution = "gaussian"
species = "electron"
sigma = "10 mm"
charge = "-10 pC"
particles = 300

[motion]
kind = "leapfrog"
dt = "10 ps"

[schedule]
steps = 1

[output]
write = ["checkpoint", "series", "fields"]
"""

# A key and values that `--set key=value` must not take.
VALUES = """
domain.lower: 0.1 | 1 | nan | -inf | '2 pC' | [0,0] | [0,0,0,0] | true | {} | -1e300 | ''
domain.upper: -0.1 | inf | nan | 1e300 | '1 parsec' | 'one metre' | -0.0999999999999999 | '1e999 m'
domain.cells: 0 | 1 | -16 | 2.5 | '16' | [16,16] | [16,1,16] | 1e3000 | 2048 | 4194304 | true
domain.cells: 10000000000000000000000
domain.boundary: 'closed' | 3 | {w='open'} | {x=['periodic','open']} | ['open'] | {x=[]} | 'Open '
domain.potential: {x='1 m'} | {x='sin('} | {x='__import__(1)'} | {x=['1 V']} | {y='1/0'} | {x='nope*x'} | 7
domain.slope: {x=3} | {q=1}
domain.size: 1
bunches: 3 | [3] | [{}] | [{distribution='gauss'}] | [{sigma=1}] | {} | 'beam.h5'
bunches.0.sigma: -1 | '10' | '10 pC' | [1,2] | nan | inf | '10 Mm' | [1e-3,-1e-3,1e-3] | true | '1_ mm' | 1e300
bunches.0.charge: 0 | nan | '10 mm' | '-10' | 1e-12 | -1e300 | inf | [1] | '-10 pc'
bunches.0.particles: -1 | 1.5 | '300' | 1e30 | 10000000000000000000000 | nan | true | 100000000000
bunches.0.species: 'elektron' | 3 | {charge=1} | {charge=0,mass=-1} | {charge='1 e',mass=0} | {charge='1 e',mass=nan}
bunches.0.species: ''
bunches.0.centre: [1,0,0] | [0,0] | nan | '10 s' | 1e300 | [0.0999,0.0999,0.0999]
bunches.0.momentum: [1e300,0,0] | '1 m' | [nan,0,0] | [0,0] | 'fast'
bunches.0.sampling: 'randomly' | 1
bunches.0.colour: 'red'
bunches.0.distribution: 'openpmd' | 'arrays' | 'k-v' | 1
bunches.4.sigma: 1
refinement.levels: -1 | 1.5 | '2' | 40 | 1e20 | nan | 10000000000000000000000
refinement.max_grid_size: 0 | -8 | 7 | '8' | 1e300
refinement.blocking_factor: 0 | 3 | -4 | '8' | 1e300
refinement.rule: {} | {kind='charge'} | {kind='charge-density'} | {kind='charge-density',relative=-1}
refinement.rule: {kind='charge-density',relative=nan} | {kind='static',boxes=[]} | 'charge-density'
refinement.rule: {kind='charge-density',relative=0.1,absolute=1}
refinement.regrid_every: -1 | 0.5 | '5' | 1e300
refinement.levles: 1
solver.tolerance: 0 | -1 | nan | 2 | 'small' | inf | '1e-8'
solver.backend: 'cuda' | 1
solver.stretch: 0 | [1,1] | [1,1,-50] | nan | '50'
solver.screening: -1 | nan | '1 m'
solver.smoother: 'jacobean' | 3
motion.dt: 0 | -1e-12 | nan | '10 m' | '10' | inf | 'never' | 1e300
motion.kind: 'euler' | 1
motion.speed: 3
motion: {} | 3 | {kind='random-walk'} | {kind='random-walk',amplitude=-1} | {kind='random-walk',amplitude='1 s'}
schedule.steps: -1 | 1e20 | 100000000000000000000 | '3' | 1.5 | nan
schedule.solves: 0 | 2 | -1
schedule.end: 3
output.write: 'all' | ['movies'] | [1] | 3 | {}
output.directory: '' | 3 | ['a']
output.checkpoint_every: -1 | '2' | 0.5
output.keep: 0 | -1 | nan
output.writers: -1 | 'many'
output.part_bytes: 0 | '1 GB'
output.format: 'silo'
elements: 3 | [{kind='quad'}] | [{kind='quadrupole'}] | [{kind='uniform',electric=[0,0,nan]}]
elements: [{kind='map',file='nowhere.h5'}] | [{kind='solenoid',field='1 m',length=1}]
apertures: [{kind='square'}] | [{kind='round'}] | [{kind='round',radius=-1}] | [{kind='round',radius='1 s'}]
electrodes: 3 | [{}] | [{name='a',voltage=1}] | [{name='a',voltage=1,shape={kind='ball',radius=1}}]
electrodes: [{name='a',shape={kind='sphere',radius=1}}] | [{name='a',voltage='1 A',shape={kind='sphere',radius=1}}]
electrodes: [{name='a',voltage='1/t',shape={kind='sphere',radius=1}}] | [{name='a',voltage=1,shape={kind='union',of=[]}}]
screens: [{name='',z=0}] | [{name='a'}] | [{name='a/b',z=0}] | [{name='a',z='1 T'}] | [{name='a',z=nan}]
diagnostics.every: -1 | 0.5
diagnostics.slices: -1 | 'ten'
diagnostics.loss_bin: -1 | 0 | '1 s'
particles.interface: 'soft' | 1
particles.compensation: 'some' | 1 | true
seed: -1 | 1.5 | 'one' | 1e300
name: '' | 'a/b' | 3
background: 'neutralizing' | 'grey'
sceen: 1
: 1
domain..lower: 1
domain.lower.9: 1
"""


def _overrides() -> Iterator[str]:
    for line in VALUES.strip().splitlines():
        key, _, values = line.partition(": ")
        yield from (f"{key}={value}" for value in values.split(" | "))


OVERRIDES = tuple(_overrides())

SCENE_FILES: Mapping[str, bytes] = {
    "empty": b"",
    "no domain": b"seed = 1\n",
    "unclosed table": b"[domain\nlower = 1\n",
    "unclosed string": SCENE.replace('"10 mm"', '"10 mm').encode(),
    "key twice": SCENE.replace("upper = 0.1", "upper = 0.1\nupper = 0.2").encode(),
    "table twice": (SCENE + "\n[domain]\nlower = 3\n").encode(),
    "latin-1": "# Länge\n".encode("latin-1") + SCENE.encode(),
    "utf-16": SCENE.encode("utf-16"),
    "zeros": bytes(1000),
    "noise": np.random.default_rng(1).bytes(4000),
    "an HDF5 file": b"\x89HDF\r\n\x1a\n" + bytes(200),
    "json": b'{"domain": {"lower": -1}}',
    "yaml": b"domain:\n  lower: -1\n",
    "a date": SCENE.replace("upper = 0.1", "upper = 2026-01-01").encode(),
    "a large number": SCENE.replace("upper = 0.1", "upper = 1" + "0" * 400).encode(),
    "a large exponent": SCENE.replace("upper = 0.1", "upper = 1e400").encode(),
    "many digits": SCENE.replace("steps = 1", "steps = " + "9" * 5000).encode(),
    "deep arrays": (SCENE + "deep = " + "[" * 2000 + "]" * 2000).encode(),
    "deep tables": (SCENE + "\n[" + ".".join("a" * 500) + "]\n").encode(),
    "long key": (SCENE + "k" * 100_000 + " = 1\n").encode(),
    "a zero byte": SCENE.replace("10 mm", "10\0mm").encode(),
    "other quotes": SCENE.replace('"', "\u201d").encode(),
    "half of it": SCENE.encode()[: len(SCENE) // 2 + 3],
    "a bunch as a table": SCENE.replace("[[bunches]]", "[bunches]").encode(),
}

COMMANDS: tuple[tuple[str, ...], ...] = (  # SCENE stands for a good scene file, OUT for a folder
    (),
    ("rnu",),
    ("run",),
    ("run", "SCENE", "SCENE"),
    ("run", "SCENE", "--setup", "a=1"),
    ("run", "SCENE", "--set"),
    ("run", "SCENE", "--set", "schedule.steps"),
    ("run", "SCENE", "--set", "=3"),
    ("run", "SCENE", "--set", "domain.lower=[1,"),
    ("run", "SCENE", "--output", ""),
    ("run", "SCENE", "--walltime", "soon"),
    ("run", "SCENE", "--walltime", "-5 min"),
    ("run", "SCENE", "--walltime=-5"),
    ("run", "SCENE", "--walltime", "0"),
    ("run", "SCENE", "--walltime", "1:2:x"),
    ("run", "SCENE", "--walltime", "-01:00:00"),
    ("run", "SCENE", "--walltime", "1.2.3"),
    ("run", "SCENE", "--walltime", "3 m"),
    ("run", "SCENE", "--walltime", "nan"),
    ("run", "SCENE", "--output", "OUT", "--restart", "nowhere"),
    ("run", "SCENE", "--output", "OUT", "--restart", "SCENE"),
    ("run", "SCENE", "--output", "OUT", "--restart", ""),
    ("run", "nowhere.toml"),
    ("run", ""),
    ("run", "OUT"),
    ("check",),
    ("check", "nowhere.toml"),
    ("check", "nowhere.h5"),
    ("check", "SCENE", "--ranks", "0"),
    ("check", "SCENE", "--ranks", "two"),
    ("check", "SCENE", "--ranks", "-1"),
    ("preview", "nowhere.toml"),
    ("preview", "SCENE", "--ranks", "0"),
    ("plot",),
    ("plot", "nowhere"),
    ("plot", "SCENE"),
    ("schema", "--markup"),
)


def _arrays(**arrays: Any) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **arrays)


def _bytes(data: bytes) -> Callable[[Path], None]:
    return lambda path: (path.write_bytes(data), None)[1]


def _cut(writer: Callable[[Path], None], share: float) -> Callable[[Path], None]:
    """A file of which a part is left."""

    def write(path: Path) -> None:
        writer(path)
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])

    return write


PLACES = np.linspace(-0.01, 0.01, 18).reshape(6, 3)


def beam(path: Path, change: Callable[[h5py.File], object] = lambda h5: None) -> None:
    """Write six electrons as openPMD, changed."""
    with h5py.File(path, "w") as h5:
        h5.attrs.update(openPMD="1.1.0", basePath="/data/%T/", particlesPath="particles/")
        group = h5.create_group("/data/1/particles/electron")
        for i, axis in enumerate("xyz"):
            group[f"position/{axis}"], group[f"momentum/{axis}"] = PLACES[:, i], np.zeros(6)
            for record in ("position", "momentum"):
                group[f"{record}/{axis}"].attrs["unitSI"] = 1.0
        group["weighting"] = np.ones(6)
        group.attrs["speciesType"] = "electron"
        change(h5)


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _text(path: Path) -> None:
    path.write_text("something else")


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


CHECKPOINT, DUMP = "run/checkpoint_00000001", "run/fields_00000001.vtkhdf"
DAMAGE: Mapping[str, Callable[[Path], object]] = {
    "half": _half,
    "flipped": _flip,
    "text": _text,
    "empty": lambda path: path.write_bytes(b""),
    "missing": lambda path: path.unlink(),
    "a folder": _folder,
}
OUTPUTS: Mapping[str, tuple[str, Callable[[Path], object], tuple[str, ...]]] = {  # file that is damaged, how, and a command
    **{
        f"restart, {kind} {name}": (
            f"{CHECKPOINT}/{name}", damage, ("run", "SCENE", "--output", "OUT", "--restart", CHECKPOINT)
        )
        for name in ("state.h5",)
        for kind, damage in DAMAGE.items()
    },
    **{
        f"check, {kind} {name}": (f"run/{name}", damage, ("check", f"run/{name.partition('/')[0]}"))
        for name in ("checkpoint_00000001/state.h5", "fields_00000001.vtkhdf", "series.csv", "openpmd/openpmd_00000001.h5")
        for kind, damage in DAMAGE.items()
        if not (kind == "missing" and "openpmd" in name)
    },
    **{
        f"plot, {kind} dump": (DUMP, damage, ("plot", DUMP))
        for kind, damage in DAMAGE.items()
        if kind != "flipped"
    },
}  # fmt: skip


def _beam(change: Callable[[h5py.Group], object]) -> Callable[[Path], None]:
    return lambda path: beam(path, lambda h5: change(h5["data/1/particles/electron"]))


def _put(group: h5py.Group, name: str, value: Any) -> None:
    if name in group:
        del group[name]
    group[name] = value


def _put_macroparticles_of_no_weight(group: h5py.Group) -> None:
    _put(group, "weighting", np.zeros(6))
    group["momentum"].attrs.update(macroWeighted=1, weightingPower=1.0)


NAN, FAR = np.array([0, 0, 0, np.nan, 0, 0]), np.full(6, 1e300)
BEAMS: Mapping[str, tuple[str, Callable[[Path], None]]] = {  # distribution, and what writes the file of a bunch
    "npz: missing": ("arrays", lambda path: None),
    "npz: text": ("arrays", _bytes(b"x y z\n0 0 0\n")),
    "npz: empty": ("arrays", _bytes(b"")),
    "npz: half": ("arrays", _cut(_arrays(position=PLACES), 0.5)),
    "npz: without its end": ("arrays", _cut(_arrays(position=PLACES), 0.95)),
    "npz: no position": ("arrays", _arrays(places=PLACES)),
    "npz: not finite": ("arrays", _arrays(position=PLACES + NAN[:, None])),
    "npz: infinite": ("arrays", _arrays(position=np.full((6, 3), np.inf))),
    "npz: two columns": ("arrays", _arrays(position=PLACES[:, :2])),
    "npz: a row": ("arrays", _arrays(position=PLACES[0])),
    "npz: texts": ("arrays", _arrays(position=np.full((6, 3), "here"))),
    "npz: objects": ("arrays", _arrays(position=np.full((6, 3), None))),
    "npz: complex": ("arrays", _arrays(position=PLACES + 1j)),
    "npz: other momenta": ("arrays", _arrays(position=PLACES, momentum=PLACES[:2])),
    "npz: momenta not finite": ("arrays", _arrays(position=PLACES, momentum=np.full((6, 3), np.nan))),
    "npz: huge momenta": ("arrays", _arrays(position=PLACES, momentum=np.full((6, 3), 1e300))),
    "npz: other weights": ("arrays", _arrays(position=PLACES, weight=np.ones(2))),
    "npz: a negative weight": ("arrays", _arrays(position=PLACES, weight=np.array([1.0, 1, -1, 1, 1, 1]))),
    "npz: a weight not finite": ("arrays", _arrays(position=PLACES, weight=NAN + 1)),
    "npz: all outside": ("arrays", _arrays(position=PLACES + 1)),
    "npz: most outside": ("arrays", _arrays(position=PLACES + np.array([1, 1, 1, 1, 0, 0])[:, None])),
    "npz: far away": ("arrays", _arrays(position=np.full((6, 3), 1e300))),
    "npz: HDF5": ("arrays", beam),
    "openpmd: missing": ("openpmd", lambda path: None),
    "openpmd: text": ("openpmd", _bytes(b"not HDF5")),
    "openpmd: empty": ("openpmd", _bytes(b"")),
    "openpmd: npz": ("openpmd", _arrays(position=PLACES)),
    "openpmd: half": ("openpmd", _cut(beam, 0.5)),
    "openpmd: without its end": ("openpmd", _cut(beam, 0.99)),
    "openpmd: a tenth": ("openpmd", _cut(beam, 0.1)),
    "openpmd: no path": ("openpmd", lambda path: beam(path, lambda h5: h5.attrs.pop("basePath"))),
    "openpmd: no particles path": ("openpmd", lambda path: beam(path, lambda h5: h5.attrs.pop("particlesPath"))),
    "openpmd: a path of numbers": ("openpmd", lambda path: beam(path, lambda h5: h5.attrs.update(basePath=3.0))),
    "openpmd: a path to nowhere": ("openpmd", lambda path: beam(path, lambda h5: h5.attrs.update(basePath="/x/%T/"))),
    "openpmd: two signs": ("openpmd", lambda path: beam(path, lambda h5: h5.attrs.update(basePath="/%T/%T/"))),
    "openpmd: two iterations": ("openpmd", lambda path: beam(path, lambda h5: h5.copy("data/1", "data/2"))),
    "openpmd: no iteration": ("openpmd", lambda path: beam(path, lambda h5: h5["data"].pop("1"))),
    "openpmd: no position": ("openpmd", _beam(lambda group: group.pop("position"))),
    "openpmd: no y": ("openpmd", _beam(lambda group: group["position"].pop("y"))),
    "openpmd: no momentum": ("openpmd", _beam(lambda group: group.pop("momentum"))),
    "openpmd: no weights": ("openpmd", _beam(lambda group: group.pop("weighting"))),
    "openpmd: two species": ("openpmd", _beam(lambda group: group.copy(group, group.parent, name="other"))),
    "openpmd: an unknown species": ("openpmd", _beam(lambda group: group.attrs.update(speciesType="muon"))),
    "openpmd: x not finite": ("openpmd", _beam(lambda group: _put(group, "position/x", NAN))),
    "openpmd: x far away": ("openpmd", _beam(lambda group: _put(group, "position/x", FAR))),
    "openpmd: x of texts": ("openpmd", _beam(lambda group: _put(group, "position/x", np.full(6, b"here")))),
    "openpmd: x is a group": ("openpmd", _beam(lambda group: (group["position"].pop("x"), group.create_group("position/x")))),
    "openpmd: x is one number": ("openpmd", _beam(lambda group: _put(group, "position/x", 0.5))),
    "openpmd: x is a matrix": ("openpmd", _beam(lambda group: _put(group, "position/x", PLACES))),
    "openpmd: y is shorter": ("openpmd", _beam(lambda group: _put(group, "position/y", np.zeros(3)))),
    "openpmd: pz not finite": ("openpmd", _beam(lambda group: _put(group, "momentum/z", NAN))),
    "openpmd: pz huge": ("openpmd", _beam(lambda group: _put(group, "momentum/z", FAR))),
    "openpmd: a negative weight": ("openpmd", _beam(lambda group: _put(group, "weighting", NAN[::-1] - 1))),
    "openpmd: momenta of macroparticles of no weight": (
        "openpmd",
        _beam(_put_macroparticles_of_no_weight),
    ),
    "openpmd: a unit of text": ("openpmd", _beam(lambda group: group["position/x"].attrs.update(unitSI="m"))),
    "openpmd: a unit not finite": ("openpmd", _beam(lambda group: group["position/x"].attrs.update(unitSI=np.nan))),
    "openpmd: an iteration that is not there": ("openpmd', iteration=7, group='electron", beam),
    "openpmd: a group that is not there": ("openpmd', group='ions", beam),
    "openpmd: a shape too large": (
        "openpmd",
        _beam(lambda group: [group["position"].pop("x"), group.create_dataset("position/x", (10**12,), "f8", chunks=(1000,))]),
    ),
}  # fmt: skip

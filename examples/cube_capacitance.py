"""Capacitance of a cube between open faces, with more and more refined levels at its edges.

Prints a line per mesh: levels, cells, those of a uniform mesh as fine, capacitance, and its error. Run it by
`.venv/bin/python examples/cube_capacitance.py`; `--levels` refines further, `--picture FILE` draws the potential and errors.
"""

import argparse
from pathlib import Path

import amrpic
from amrpic import shapes

EXACT = 73.51036e-12  # F, of a cube with sides of 1 m

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--levels", type=int, default=3, help="most refined levels at the edges")
parser.add_argument("--picture", type=Path, help="a PNG of the potential and the errors")
arguments = parser.parse_args()

cube = amrpic.Electrode("cube", shapes.Box((-0.5,) * 3, (0.5,) * 3), voltage="1 V")
domain = amrpic.Domain(-2, 2, 32)
cells, errors = [], []
print("levels  cells  uniform  capacitance (pF)  error")
for levels in range(arguments.levels + 1):
    hierarchy = amrpic.Hierarchy.around(domain, [cube], levels=0, edges=levels)
    solver = amrpic.PoissonSolver(hierarchy, electrodes=[cube])
    phi, report = solver.solve(amrpic.Field(hierarchy))
    capacitance = report.charges["cube"] / 1.0
    cells.append(hierarchy.cells())
    errors.append(capacitance / EXACT - 1)
    print(f"{levels}  {cells[-1]}  {(32 * 2**levels) ** 3}  {1e12 * capacitance:.4f}  {errors[-1]:.1e}")

if arguments.picture:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    raster = phi.slice("z", 0.49)
    shown = left.imshow(raster.values.T, origin="lower", extent=(-2, 2, -2, 2), cmap="viridis")
    for number, colour in enumerate(("#bbbbbb", "w", "orange", "r")[: hierarchy.levels]):
        for a, b, c, d, e, f in hierarchy.boxes(number) if number else ():
            width = hierarchy.spacing(number)
            if c * width[2] <= 2.49 < (f + 1) * width[2]:
                corner, size = (a * width[0] - 2, b * width[1] - 2), ((d + 1 - a) * width[0], (e + 1 - b) * width[1])
                left.add_patch(plt.Rectangle(corner, *size, fill=False, edgecolor=colour, linewidth=0.6))
    left.set(xlabel="x (m)", ylabel="y (m)", title="φ beside the upper face, and boxes")
    figure.colorbar(shown, ax=left, label="φ (V)")
    right.loglog(cells, [abs(error) for error in errors], "o-", label="levels at the edges")
    uniform = [(32 * 2**level) ** 3 for level in range(len(cells))]
    right.loglog(uniform, [abs(error) for error in errors], "o:", label="cells of a uniform mesh as fine")
    right.set(xlabel="cells", ylabel="error of the capacitance")
    right.legend(fontsize="small")
    figure.savefig(arguments.picture, dpi=110)

"""Time pycompadre on neighbours that others found, and write its weights: a process of its own, without amrpic.

`compadre_peer.py IN OUT`: IN holds x (m, 3), start, index and reach of its neighbours, order, runs, and the numbers of some
targets; all points are targets. OUT gets seconds (runs,) of thread time, and weights of value, gradient and Laplacian of those
targets, (entries, 5).
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pycompadre


def main() -> None:
    given = np.load(sys.argv[1])
    x, start, index = given["x"], given["start"], given["index"]
    kokkos = pycompadre.KokkosParser()
    lengths = np.diff(start)
    lists = np.zeros((len(x), 1 + lengths.max()), dtype=np.int32)
    lists[:, 0] = lengths
    lists[:, 1:][np.arange(lengths.max()) < lengths[:, None]] = index
    targets = pycompadre.TargetOperation
    operations = [
        targets.ScalarPointEvaluation,
        targets.GradientOfScalarPointEvaluation,
        targets.LaplacianOfScalarPointEvaluation,
    ]
    seconds = []
    for _ in range(int(given["runs"])):
        gmls = pycompadre.GMLS(int(given["order"]), 3, "QR", "STANDARD", "NO_CONSTRAINT")
        gmls.setWeightingType("power")
        gmls.setWeightingParameter(2, 0)
        gmls.setWeightingParameter(1, 1)
        helper = pycompadre.ParticleHelper(gmls)
        helper.generateKDTree(x)
        helper.setTargetSites(x)
        helper.setNeighbors(lists)
        helper.setWindowSizes(given["reach"])
        gmls.addTargets(operations)
        begin = time.thread_time()
        gmls.generateAlphas(1, False)
        seconds.append(time.thread_time() - begin)
    found = gmls.getSolutionSet()
    weights = [
        [
            found.getAlpha(operation, int(t), component, 0, j, 0, 0)
            for operation, components in zip(operations, (1, 3, 1), strict=True)
            for component in range(components)
        ]
        for t in given["targets"]
        for j in range(lengths[t])
    ]
    np.savez(sys.argv[2], seconds=seconds, weights=np.array(weights))
    del found, helper, gmls, kokkos

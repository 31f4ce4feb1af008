#pragma once

#include <vector>

#include "mesh/box.hpp"

namespace amrpic {

/// Few disjoint boxes that hold all of `blocks` (in units of blocks; any order, repeats allowed).
///
/// In each box at least the fraction `efficiency` of its places is among `blocks`, or it is a single one. The algorithm
/// is that of Berger and Rigoutsos (IEEE Trans. Syst. Man Cybern. 21, 1278, 1991): a box that is too empty is cut where
/// a plane is empty, else where the number of blocks per plane changes most, else in the middle. Integers decide
/// everything but the efficiency, so the same blocks give the same boxes everywhere.
std::vector<Box> cluster(std::vector<Index3> blocks, Real efficiency);

}  // namespace amrpic

// One image of charge, as a map of the places where its potential is wanted.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <tuple>

#include "freespace/lattice.hpp"

namespace amrpic::freespace {

/// A map of the lattice onto itself: along each axis a shift, after a reflection perhaps; and the sign that it gives
/// charge.
struct Image {
  std::array<bool, 3> reflects{};
  Cell shift{};  ///< in cells of the base
  int sign = 1;

  double place(int d, double x, double spacing) const {
    return (reflects[std::size_t(d)] ? -x : x) + shift[std::size_t(d)] * spacing;
  }
  int cell(int d, int cell, int level) const {
    return int((reflects[std::size_t(d)] ? -1 - cell : cell) + std::int64_t(shift[std::size_t(d)]) * (1LL << level));
  }
  /// This one of what another one maps to.
  Image after(Image const& first) const;
  Image inverse() const;
  bool operator<(Image const& o) const {
    return std::tie(reflects, shift, sign) < std::tie(o.reflects, o.shift, o.sign);
  }
};

/// Which of the images across the walls of one axis count, where charge moves along it: those that move with the
/// charge, itself among them, or those that move against it, behind a single reflection.
enum class Which { all, with, against };

/// The axis that charge moves along, if walls across it reflect what moves against it; their places, in m, or nan, at
/// the faces or outside the mesh; and the signs of images: -1 conductors.
struct Across {
  int axis = -1;
  std::array<double, 2> place{std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::quiet_NaN()};
  std::array<int, 2> sign{-1, -1};
};

}  // namespace amrpic::freespace

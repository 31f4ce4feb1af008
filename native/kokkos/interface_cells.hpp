#pragma once

#include "cycle/interface_cells.hpp"
#include "kokkos/fits.hpp"

namespace amrpic::kokkos {

/// A cycle::InterfaceCells as lists of coarse faces. Faces of one direction share no cell, so each act is a kernel
/// for each of the six.
class InterfaceCells {
 public:
  InterfaceCells() = default;
  InterfaceCells(cycle::InterfaceCells const& plan, cycle::Layout const& layout);

  /// See cycle::InterfaceCells.
  void start() { fill(lists_.taken, FourStars<float>{}); }
  void subtract_coarse(Array<float> const& coarse_values, Array<float> const& r) const;
  void subtract_in_gaps(Array<float> const& e, Array<float> const& r) const;
  void subtract_flux(Array<float> const& e, Array<float> const& coarse_values) const;

  std::size_t bytes() const;

  // What kernels read, public because CUDA wants it to be.
  struct Face {
    std::int32_t side, cell, parent;
    std::int32_t fit;  ///< its number, or ~(that of the gap)
  };
  struct Lists {
    Array<cycle::InterfaceSteps> sides;
    Array<Face> faces;
    NumberedFits fits;
    GapTerms coarse_terms, fine_terms;
    Array<FourStars<float>> taken;  ///< of each gap
    Array<cycle::MetalSteps> beside_metal;
    GapTerms metal_terms;
  };

 private:
  template <class F>
  void for_each_face(char const* name, F const& f) const {
    for (Range const& part : of_direction_) for_each(name, part, f);
  }
  template <class F>
  void for_each_beside_metal(char const* name, F const& f) const {
    for (Range const& part : beside_metal_) for_each(name, part, f);
  }

  Lists lists_;
  std::array<Range, 6> of_direction_, beside_metal_;
};

}  // namespace amrpic::kokkos
